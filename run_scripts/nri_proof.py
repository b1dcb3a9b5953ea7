"""The old name of `python -m reports nri_proof`, kept for one release."""

from reports.__main__ import run

if __name__ == '__main__':
    run('nri_proof')
