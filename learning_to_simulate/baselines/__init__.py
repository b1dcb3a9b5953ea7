"""Baselines: every frame follows from the known motion alone, nothing is fed back.

open_loop: persistence, constant velocity, mean force, and what a prediction is.
earthmoving, wheel_terramechanics: published formulas of a blade and of a wheel.
path_ridge: kernel ridge regression on the path so far.
method, settings: the last three behind `registry`.
"""
