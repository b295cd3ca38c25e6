"""Walking that is not periodic: `initial_states`, `lyapunov` exponents, and the `crisis` in which walking is lost."""
