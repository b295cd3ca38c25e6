"""Finished results, safe against any interruption of a run.

`journal` stores them in SQLite; `rows` defines and checks rows; `salvage` reads rows from a damaged file; `compact`
joins small blocks; `lines` reads the points of a line.
"""
