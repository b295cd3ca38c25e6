"""How a study is divided: the method of its lines, the cost of its points, and chunks.

A chunk is a rectangle of lines x slopes that the study alone determines. It is what one job computes, what has a key
and a record in the store, and what is packed as one piece of every variable of the archive.
"""
