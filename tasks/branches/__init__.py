"""Solution branches over slope, and the curves of their special points.

`tracking` follows branches; `branch` is one, with polynomials between its nodes;
`atlas` finds all of a line's, for many lines at once: `segment` and `ends` find where a
property changes on a branch and where walking ends, `refine` adds nodes and `checks`
looks at the whole of it, all as procedures that `lockstep` runs side by side.
`sampling` chooses points to draw. `conditions` has what defines folds, flips and the
like; `equations` puts conditions beside the equations of a gait and solves them;
`passings` finds where a branch passes conditions between its nodes, `special_points`
gathers these with folds and ends, `extremes` locates them on the branches of designs,
`curves` follows them as keys vary, `meetings` locates where two conditions meet on such
a curve. `joint` has the linearised equations of a gait, `settling` gaits at slopes from
guesses on branches, `nearest` the gaits of a line
nearest to given states. `flips` begins the branches of twice as many steps.
These and `tracking` share the corrector, predictor and step control of
`pseudo_arclength`; `root` finds roots in brackets.
"""
