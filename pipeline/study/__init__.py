"""The request: a study's TOML file, read, checked as a whole and frozen.

`model` is a checked study; `parse` makes one from a file, `broadcast` from a walker and
arrays; `single_point` asks for the gaits at one slope. `options` checks the options of
a study's kind, `slopes` its slopes, `corners` its walkers at the corners of the grid;
`overlay` reads the user's measurements, `plot` is a figure of another package; `files`
reads the TOML files of studies and walkers, `toml` writes values; `location` names the
place of an error in a file; `units` and `ways` are words for units and for what
detuning leads to; `schema` describes all of this to editors.
"""
