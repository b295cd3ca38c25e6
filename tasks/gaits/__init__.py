"""Period-one gaits as fixed points of the step map.

`newton` iterates in batches; `search` begins with a lattice of initial guesses;
`rounding` measures how far rounding moves a fixed point; `polish` turns guesses into
gaits with error bounds; `step_check`, `labels` and `multipliers` classify them.
"""
