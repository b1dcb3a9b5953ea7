"""The old name of `python -m reports results_table`, kept for one release."""

from reports.__main__ import run

if __name__ == '__main__':
    run('results_table')
