"""One step of a walker: from just after one heelstrike to just after the next.

`problem` is a walker with its constants filled in; `step_map` maps the section to
itself with exact derivatives; `simulate` finds the strikes from any state;
`verify_step` decides whether a solved step happens; `extended_precision` solves to more
digits.
"""
