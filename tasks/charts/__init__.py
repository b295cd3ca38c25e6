"""Families of lines: gaits over one or two keys of a walker, predicted by polynomials
and solved at each point.

`box` draws cells and nodes in the space of the keys, `pieces` finds the pieces of the
node lines' branches and matches them. `chart` holds polynomials with an error that was
measured, and adds nodes to them; `span` the position along a piece that they run in.
`cell` makes and checks the patches of a box, charts of gaits over position and keys;
`sheet` fits those that give gaits to an accuracy;
`manifold_maker` makes charts of special points over the keys, `extension` of one point
through those to which `carry` takes it, and `cut` finds where they end; `kinds` tells
them apart. `tuning` finds where walkers are tuned, beside which both are divided. A
patch predicts; every value and verdict comes from the point's own steps.
"""
