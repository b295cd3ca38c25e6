"""Walking that is not periodic: `initial_states`, `lyapunov` exponents, and the `crisis` that ends an attractor."""
