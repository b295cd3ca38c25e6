"""What is wanted: a study's TOML file, read, checked whole and frozen.

`model` is a checked study; `parse` makes one of a file; `options` checks the options of its kind; `files` reads the
TOML
files of studies and walkers; `location` says where in a file an error is; `single_point` asks for the gaits at one
slope.
"""
