"""Measures of a gait: impact `losses`, `kinematics` over a step, and `violations` of
the model's assumptions.
"""
