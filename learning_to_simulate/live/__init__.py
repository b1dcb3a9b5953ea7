"""Steppers and paths of models in the subspace or on particles; poses (of soil fields, too)."""
