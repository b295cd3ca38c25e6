"""The netCDF file: `layout` of its chunks, `write`, `read`, `verify` and `diff`.

`chunks` packs variables, `result_tables` gives columns their names and units, `provenance` and `citation` say where an
archive is from.
"""
