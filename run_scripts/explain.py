"""The old name of `python -m reports explain`, kept for one release."""

from reports.__main__ import run

if __name__ == '__main__':
    run('explain')
