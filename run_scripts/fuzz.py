"""The old name of `python -m reports fuzz`, kept for one release."""

from reports.__main__ import run

if __name__ == '__main__':
    run('fuzz')
