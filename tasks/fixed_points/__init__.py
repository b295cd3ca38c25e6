"""Period-one gaits as fixed points of the step map.

`newton` iterates in batches; `search` starts from nothing; `rounding` measures how well a fixed point is known;
`polish`
turns guesses into gaits with error bounds; `step_check`, `labels` and `multipliers` say what they are.
"""
