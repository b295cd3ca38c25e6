"""Finished results, safe against any interruption of a run.

`store` keeps records by their keys in SQLite; `file` opens, recognises and repairs its file; `record` packs the points
of a chunk, by the filters of `packing`.
"""
