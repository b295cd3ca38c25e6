"""The stride map, its fixed points, and their continuation."""
