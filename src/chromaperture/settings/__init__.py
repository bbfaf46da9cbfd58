"""Settings of the methods and of their stages, and how they are read from TOML."""
