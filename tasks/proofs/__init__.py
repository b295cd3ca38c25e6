"""Computer-assisted proofs of gaits in ball arithmetic, from equations of their own
(docs/proofs.md).

`keys` reads a walker's keys as balls and `body` lumps them; `motion`, `collisions` and
`stability` are the mechanics; `enclosure` encloses flows and `enclosed_step` steps;
`krawczyk` proves existence, `signs` and `sequence` the order of strikes; `gait` puts a
theorem together, `tubes`, `covers` and `crossings` those along a branch, kept as
`records`.
"""
