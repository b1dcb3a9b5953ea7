"""The old name of `python -m reports coarse_solver`, kept for one release."""

from reports.__main__ import run

if __name__ == '__main__':
    run('coarse_solver')
