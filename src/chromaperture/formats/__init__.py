"""Results in the formats of other programs; each file takes arrays and knows one format."""
