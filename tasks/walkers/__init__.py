"""Walkers: `walker` defines and checks one, `catalogue` holds the paper's, `resolve`
makes one of a name or a table.

`tuning` has the static conditions of section 5.1 of the paper, `describe` what is shown
of a walker.
"""
