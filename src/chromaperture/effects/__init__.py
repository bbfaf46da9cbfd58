"""Pictures made with depth: everything in focus, focus elsewhere, effects."""
