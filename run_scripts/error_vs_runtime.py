"""The old name of `python -m reports error_vs_runtime`, kept for one release."""

from reports.__main__ import run

if __name__ == '__main__':
    run('error_vs_runtime')
