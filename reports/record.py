"""What a number was made by and on: command, commit, machine."""

import importlib.metadata
import os
import platform
import subprocess
import sys

import numpy as np

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def provenance(threads: int | None = None) -> dict:
    """Command, commit and machine, for the head of a report's JSON; `threads` of the CPU are those
    that TensorFlow was given, None where that decides nothing."""
    command = ' '.join(['python -m', *sys.argv])
    return {'command': command, 'commit': _commit(), 'machine': _facts(threads)}


def four(value) -> float | None:
    """A number of a report to four digits; None where there is none, or none that is finite."""
    return None if value is None or not np.isfinite(value) else float(f'{value:.4g}')


def _commit():
    """The commit of the sources, with '+' where files differ from it; None outside a checkout."""
    describe = ['describe', '--always', '--exclude=*', '--abbrev=12', '--dirty=+']
    try:
        done = subprocess.run(
            ['git', '-C', ROOT, *describe], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def _facts(threads: int | None) -> dict:
    """The machine, its load and the versions that decide about times."""
    return {
        'cpu': _first_field('/proc/cpuinfo', 'model name') or platform.processor(),
        'cores': os.cpu_count(),
        'memory': _first_field('/proc/meminfo', 'MemTotal'),
        'load_average_1min': round(os.getloadavg()[0], 2),
        'system': f'{platform.system()} {platform.machine()}',
        'python': platform.python_version(),
        'tensorflow': _version('tensorflow-cpu') or _version('tensorflow'),
        'numpy': _version('numpy'),
        'threads': threads,
    }


def _first_field(path, name):
    try:
        with open(path, encoding='utf-8') as file:
            return next((x.split(':', 1)[1].strip() for x in file if x.startswith(name)), None)
    except OSError:
        return None


def _version(package):
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
