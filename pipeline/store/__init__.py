"""Finished results by their keys: the journal beside an archive.

`store` keeps records in SQLite; `file` opens, recognises and repairs its file; `record`
packs the points of a chunk, by the filters of `packing`; `memory` keeps records in a
dictionary, for Python's `gaits` and `solve`. A run that is killed loses no record, a
power failure at most those of the last half second.
"""
