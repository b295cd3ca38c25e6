"""One step of a walker: from just after one heelstrike to just after the next.

`problem` is a walker with its constants in place; `step_map` maps the section to itself with exact derivatives;
`simulate`
finds the strikes from any state; `verify_step` says whether a solved step happens; `extended_precision` has more
digits.
"""
