"""Finished results by their keys: the journal beside an archive.

`store` says what a store is; `journal` keeps records in SQLite, whose file `file`
opens, recognises and repairs, `memory` in a dictionary; `record` packs the points of a
chunk, by the filters of `packing`. A run that is killed loses no record, a power
failure at most those of the last half second.
"""
