"""The command line: `commands` parses and dispatches by the table in `commands.toml`, each command is a module."""
