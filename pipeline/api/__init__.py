"""Functions for notebooks and scripts.

`studies` runs studies and loads their archives; `in_memory` solves gaits of arrays
without files; `steps` evaluates the step map and simulates; `reports` makes pages and
single figures; `threads` lets several threads call them.
"""
