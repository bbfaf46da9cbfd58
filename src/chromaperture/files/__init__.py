"""Files of other programs: each module takes arrays and knows one format; pages that need no server."""
