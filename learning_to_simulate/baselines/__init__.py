"""Baselines: every frame follows from the known motion alone, nothing is fed back.

earthmoving, wheel_terramechanics: published formulas of a blade and of a wheel, as functions.
path_ridge: kernel ridge regression on the path so far; method: that behind `registry`.
"""
