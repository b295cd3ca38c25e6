"""The command line.

`commands` parses and dispatches by the table in `commands.toml`. Each command is a
module of its name; `kinds` are those of arguments, `studies` finds the studies that a
command names, `errors` says an error in a line.
"""
