"""Optimiser, schedule, checkpoints and the loop of the networks of `subspace` and `full_space`."""
