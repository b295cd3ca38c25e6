"""The request: a study's TOML file, read, checked as a whole and frozen.

`model` is a checked study; `parse` makes one from a file; `options` checks the options of its kind; `files` reads the
TOML files of studies and walkers, `toml` writes values; `location` names the place of an error in a file;
`single_point` returns the gaits at one slope.
"""
