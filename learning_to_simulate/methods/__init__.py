"""Swept field and baselines; `learning_to_simulate.registry` lists all methods."""
