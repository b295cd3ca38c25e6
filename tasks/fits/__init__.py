"""Laws fitted to arrays of gaits."""
