"""The netCDF file of a study: written, read, verified and compared.

`write` makes the file: `points` its values over the grid, chunk by chunk and unchanged
from the store (`direct_chunks`), `result_tables` its groups, `parameters` those of the
walkers, `attributes` the CF attributes, `provenance` and `citation` where all came
from; `layout` and `written` are what these share. `read` opens files that may be
foreign or damaged, `unfold` makes tables of their groups, `structure` knows the layout,
`verify` and `diff` are the commands of their names.
"""
