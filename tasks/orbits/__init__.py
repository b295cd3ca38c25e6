"""Walking that is not periodic.

A `walk` from `initial_states` leads to `attractors`; `lyapunov` has their exponents,
`crisis` where one ends, and `stable_manifold` an edge of its basin.
"""
