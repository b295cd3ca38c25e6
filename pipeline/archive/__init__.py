"""The netCDF file: `layout` of its chunks, `write`, `read`, `verify` and `diff`.

`chunks` packs variables, `result_tables` writes tables with units, `provenance` and `citation` record the origin of an
archive.
"""
