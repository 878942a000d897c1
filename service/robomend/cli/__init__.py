"""The `robomend` command: one file a subcommand, loaded when it is asked for."""
