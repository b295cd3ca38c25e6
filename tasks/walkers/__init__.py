"""Walkers: `walker` is one, checked; `catalogue` has the paper's; `resolve` makes one of a name or a table and keys.

`tuning` has the static conditions of section 5.1, `describe` what is shown of a walker.
"""
