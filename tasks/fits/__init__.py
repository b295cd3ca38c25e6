"""Laws fitted to arrays: `power_law`, the `transition` between two power laws, and
`feigenbaum` ratios.
"""
