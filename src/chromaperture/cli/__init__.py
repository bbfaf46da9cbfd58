"""The command line: one file a subcommand, each a thin layer over public functions."""
