"""Solution branches over slope, and the curves of their special points.

`tracking` follows branches; `branch` is one, with polynomials between its nodes; `atlas` finds all of a line's;
`sampling` chooses points to draw; `special_points` locates folds, flips and ends; `cycles` follows gaits of period n
and `codimension_one` curves of special points; `root` finds roots in brackets.
"""
