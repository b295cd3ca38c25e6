"""Walkers: their parameters, the catalogue, statics and tuning."""
