"""Equations of motion, impacts, and their compiled flows."""
