"""Scenes beyond blade and wheel: small data of our solver, trained and told in a table."""
