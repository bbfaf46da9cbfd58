"""Files, pictures and streams written from measured frames."""
