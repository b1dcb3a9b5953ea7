"""The old name of `python -m reports stability_report`, kept for one release."""

from reports.__main__ import run

if __name__ == '__main__':
    run('stability_report')
