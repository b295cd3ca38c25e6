"""Families of lines: gaits over one or two keys of a walker, predicted by polynomials and solved at each point.

`box` draws cells and nodes in the space of the keys, `pieces` finds the pieces of the node lines' branches and matches
them, `patch` holds the polynomials of a piece over slope and keys, `cell` makes and checks the patches of a box.
A patch predicts; every value and verdict comes from the point's own steps.
"""
