"""The old name of `python -m reports compare_forces`, kept for one release."""

from reports.__main__ import run

if __name__ == '__main__':
    run('compare_forces')
