"""What a time was measured on."""

import importlib.metadata
import os
import platform


def facts(threads: int) -> dict:
    """The machine, its load and the versions that decide about times.

    Args:
      threads: CPU threads that TensorFlow was given.
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


def sentence(values: dict) -> str:
    """The facts in one line for tables and pictures."""
    return (
        f'{values["cpu"]}, {values["cores"]} cores, {values["threads"]} thread(s) used, '
        f'TensorFlow {values["tensorflow"]}, load {values["load_average_1min"]} at the start'
    )


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
