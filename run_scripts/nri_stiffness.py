"""The old name of `python -m reports nri_stiffness`, kept for one release."""

from reports.__main__ import run

if __name__ == '__main__':
    run('nri_stiffness')
