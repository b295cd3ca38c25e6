"""Finished results, safe against whatever ends a run.

`journal` keeps them in SQLite; `rows` says what a row holds and checks it; `salvage` reads rows from a damaged file;
`compact` puts small blocks together; `lines` reads the points of a line back.
"""
