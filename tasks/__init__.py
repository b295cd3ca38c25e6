"""What is true at a grid point: walkers, mechanics, gaits, measures and fits. Arrays
in, arrays out.
"""
