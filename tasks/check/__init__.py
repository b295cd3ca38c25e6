"""Whether states are gaits of a walker, and if not, why: `check_states` tries rules in order,
the other modules hold them.
"""
