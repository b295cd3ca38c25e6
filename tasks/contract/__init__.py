"""What others may rely on: tasks, variables, options, kinds of points, costs."""
