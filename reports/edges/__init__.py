"""Edges between modes: what they are worth, and whether they can be found."""
