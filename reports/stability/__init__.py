"""The cases of `reports stability`, one file per part of the project."""
