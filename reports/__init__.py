"""Reports: what is measured, compared and drawn. `python -m reports` lists them.

Nothing imports this package but `run_scripts` and the tests.
"""
