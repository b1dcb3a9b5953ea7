"""The old name of `python -m reports training_speed`, kept for one release."""

from reports.__main__ import run

if __name__ == '__main__':
    run('training_speed')
