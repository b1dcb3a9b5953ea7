"""Running the commands of the package as a person does."""

import pathlib
import subprocess
import sys

REPOSITORY = pathlib.Path(__file__).resolve().parents[2]


def run_command(*arguments):
    """Runs `python -m <arguments>` in the repository; returns the finished process."""
    return subprocess.run(
        [sys.executable, '-m', *arguments],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
