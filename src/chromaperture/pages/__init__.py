"""Pages for the browser that need no server and no other file: maps with their values, and clouds of points."""
