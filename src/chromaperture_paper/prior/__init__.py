"""What one used before, written from the formulas of the publications: the project's own method beside its field."""
