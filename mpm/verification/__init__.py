"""Checks of the solver with numbers: closed forms, published laws, its own convergence."""
