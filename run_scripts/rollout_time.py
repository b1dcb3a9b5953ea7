"""The old name of `python -m reports rollout_time`, kept for one release."""

from reports.__main__ import run

if __name__ == '__main__':
    run('rollout_time')
