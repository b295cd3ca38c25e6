"""How a study is divided: the method of its lines, the cost of its points, and chunks.

A chunk (`grid`) is a rectangle of lines x slopes that is fixed by the study, and where
results are kept in memory by that too. It has a key and a record in the store; a job
computes what of it is missing; it is one packed piece of each variable and gait in the
archive. `method` lists the ways to compute points, `choose_method` decides by `costs`
which of them serves a study; `boxes` divides arrays that are read part by part.
"""
