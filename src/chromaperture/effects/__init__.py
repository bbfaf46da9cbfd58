"""Pictures computed from depth: everything in focus, another focus, effects."""
