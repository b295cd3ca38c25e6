"""Laws fitted to arrays: `power_law`, the `transition` between two of them, and `feigenbaum` ratios."""
