"""What a gait is worth: energy and physical violations."""
