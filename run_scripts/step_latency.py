"""The old name of `python -m reports step_latency`, kept for one release."""

from reports.__main__ import run

if __name__ == '__main__':
    run('step_latency')
