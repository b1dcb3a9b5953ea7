"""Baselines: every frame follows from the known motion alone, nothing is fed back.

earthmoving, wheel_terramechanics: published formulas of a blade and of a wheel.
path_ridge: kernel ridge regression on the path so far.
method: these three behind `registry`; open_loop: what they predict.
"""
