"""The command line: one short file a subcommand, skins over public functions."""
