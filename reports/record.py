"""What a number was made by and on: command, commit, machine; and JSON that a sweep resumes."""

import importlib.metadata
import os
import platform
import subprocess
import sys

from pca_tools import files

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def provenance(threads: int | None = None) -> dict:
    """Command, commit and machine, for the head of a report's JSON.

    Args:
      threads: CPU threads that TensorFlow was given; None where that decides nothing.
    """
    name = os.path.basename(sys.argv[0]).removesuffix('.py')
    module = getattr(sys.modules['__main__'], '__spec__', None)
    command = ' '.join(['python -m', module.name if module else name, *sys.argv[1:]])
    return {'command': command, 'commit': _commit(), 'machine': facts(threads)}


def data_version(metadata: dict) -> int:
    """Of a dataset: that of the first case that states one; 1 of those made before it was."""
    cases = (case for split in metadata.get('cases', {}).values() for case in split)
    return int(next((case['data_version'] for case in cases if 'data_version' in case), 1))


def resume(path: str, identity: dict, empty: dict) -> dict:
    """The document of an earlier call, to go on with, or a new one.

    Args:
      path: JSON file, which need not exist.
      identity: what must be the same for its rows to count: data, budget.
      empty: the other keys of a new document.

    Raises:
      ValueError: the file holds rows of something else; nothing is overwritten.
    """
    if not os.path.exists(path):
        return identity | empty
    found = files.read_json(path)
    if not isinstance(found, dict) or not found.keys() >= empty.keys():
        raise ValueError(f'{path}: holds something else; give another output_path')
    for key, value in identity.items():
        if found.get(key) != value:
            raise ValueError(
                f'{path}: holds rows of another {key} ({found.get(key)} there, {value} now); '
                'give another output_path'
            )
    return found


def _commit():
    """The commit of the sources, with '+' where files differ from it; None outside a checkout."""
    try:
        done = [
            subprocess.run(
                ['git', '-C', ROOT, *arguments], capture_output=True, text=True, check=True
            ).stdout.strip()
            for arguments in (
                ['rev-parse', '--short=12', 'HEAD'],
                ['status', '--porcelain', '--untracked-files=no'],
            )
        ]
    except (OSError, subprocess.CalledProcessError):
        return None
    return done[0] + '+' * bool(done[1])


def facts(threads: int | None) -> dict:
    """The machine, its load and the versions that decide about times.

    Args:
      threads: CPU threads that TensorFlow was given; None where that decides nothing.
    """
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
