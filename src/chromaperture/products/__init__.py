"""Files, pictures and streams made from measured frames."""
