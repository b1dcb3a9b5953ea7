"""A training run on disk: one loop for every method, its state, its end by a signal."""
