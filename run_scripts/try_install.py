"""Installs the project as a user does, in each Python that is named, and tries it.

Per interpreter, in an empty environment and an empty folder: `pip install .[cpu]` with the pins of
`constraints.txt`, `pip check`, the files of all packages held against `hashes.txt`, and a minute of
use: a shipped model is loaded and stepped, raw runs are written and converted, a model is trained
for two steps and judged. Standard library only.

Examples:
    python run_scripts/try_install.py python3.11 python3.12 python3.13
    python run_scripts/try_install.py ~/.pyenv/versions/3.13.0/bin/python --output_path=docs
"""

import argparse
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from run_scripts import verified_install  # noqa: E402

EXTRA = 'cpu'
_LEFT_OUT = ('.*', 'build', '*.egg-info', '__pycache__', 'datasets', 'models', 'tests')
# What is imported must be what was installed: nothing of the sources lies on its path.
SMOKE = """
import importlib.util, json, pathlib, sys
root = pathlib.Path(sys.argv[1])
import learning_to_simulate as lts
assert root not in pathlib.Path(lts.__file__).parents, lts.__file__
model = lts.load(str(root / 'models' / 'excavation' / 'pcg'))
live = model.stepper()
pose = model.starts.pose[0].copy()
live.start(pose, velocity=[-0.05, -0.03, 0.0])
for _ in range(60):
    pose[:3] += [-0.05 / 60, -0.03 / 60, 0.0]
    frame = live.step(pose)
assert frame.status == 'ok' and frame.force[0] > 0, frame
example = root / 'examples' / 'your_own_data.py'
spec = importlib.util.spec_from_file_location('example', example)
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
module.main('own', num_steps=2, unroll_steps=0)
assert (pathlib.Path('own') / 'data' / 'manifest.json').exists()
"""


def try_python(python: str) -> dict:
    """Installs and tries the project with one interpreter.

    Args:
        python: its path or name.

    Returns:
        Its version, seconds of each part, packages, and size of the environment in MB.

    Raises:
        subprocess.CalledProcessError: a part fails; what it said is on the terminal.
    """
    with tempfile.TemporaryDirectory() as folder:
        new = os.path.join(folder, 'venv', 'bin', 'python')
        subprocess.run([python, '-m', 'venv', os.path.join(folder, 'venv')], check=True)
        pip = [new, '-m', 'pip', '--disable-pip-version-check']
        source = os.path.join(folder, 'source')  # pip builds where the sources lie
        shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(*_LEFT_OUT))
        version = _said([new, '-c', 'import platform; print(platform.python_version())'])
        row = {'python': version.strip()}
        pins = ['--constraint', str(ROOT / 'constraints.txt')]
        install = [*pip, 'install', '--quiet', *pins, f'{source}[{EXTRA}]']
        row['install_s'] = _seconds(install, folder)
        subprocess.run([*pip, 'check'], check=True)
        listed = json.loads(_said([*pip, 'list', '--format=json']))
        row['packages'] = len(listed)
        row['size_mb'] = round(_size(os.path.join(folder, 'venv')) / 1e6)
        _hold_against_digests(pip, {p['name'] for p in listed}, folder)
        row['smoke_s'] = _seconds([new, '-c', SMOKE, str(ROOT)], folder)
    return row


def _hold_against_digests(pip, installed, folder):
    """Fetches the wheels of all packages again, and takes them by their digests alone."""
    text = (ROOT / 'hashes.txt').read_text(encoding='utf-8')
    lines = verified_install.chosen_lines(text, [EXTRA])
    names = {_normal(line.split('==')[0]) for line in lines}
    own = 'learning-to-simulate-soil'
    if left := {_normal(name) for name in installed} - names - {own}:
        raise ValueError(f'installed, and not in hashes.txt: {sorted(left)}')
    path = os.path.join(folder, 'hashes.txt')
    pathlib.Path(path).write_text('\n'.join(lines), encoding='utf-8')
    fetch = [*pip, 'download', '--quiet', '--no-deps', '--require-hashes', '--no-build-isolation']
    subprocess.run([*fetch, '--dest', os.path.join(folder, 'wheels'), '-r', path], check=True)


def _normal(name):
    return re.sub('[-_.]+', '-', name.lower())


def _said(command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def _seconds(command, folder):
    start = time.monotonic()
    subprocess.run(command, check=True, cwd=folder)
    return round(time.monotonic() - start)


def _size(folder):
    paths = (os.path.join(top, name) for top, _, names in os.walk(folder) for name in names)
    return sum(os.lstat(path).st_size for path in paths)


def keep(row: dict, path: str) -> None:
    """Puts a row into an `install.json`, beside those of other Pythons."""
    file = pathlib.Path(path)
    rows = json.loads(file.read_text(encoding='utf-8'))['rows'] if file.exists() else []
    rows = [*(r for r in rows if r['python'] != row['python']), row]
    rows.sort(key=lambda r: [int(part) for part in r['python'].split('.')])
    minor = ['python' + '.'.join(r['python'].split('.')[:2]) for r in rows]
    command = ' '.join(['python run_scripts/try_install.py', *minor, '--output_path=docs'])
    text = json.dumps({'command': command, 'rows': rows}, indent=2) + '\n'
    file.write_text(text, encoding='utf-8')


def table(path: str) -> str:
    """The rows of an `install.json`, as Markdown."""
    rows = json.loads(pathlib.Path(path).read_text(encoding='utf-8'))['rows']
    lines = ['| Python | packages | MB | install s | smoke test s |', '|---|---|---|---|---|']
    keys = ('python', 'packages', 'size_mb', 'install_s', 'smoke_s')
    lines += ['| ' + ' | '.join(str(row[key]) for key in keys) + ' |' for row in rows]
    return '\n'.join(lines)


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('pythons', nargs='+', help='interpreters')
    parser.add_argument('--output_path', help='folder for install.json')
    values = parser.parse_args()
    for python in values.pythons:
        row = try_python(python)
        print(row, flush=True)
        if values.output_path:
            keep(row, os.path.join(values.output_path, 'install.json'))


if __name__ == '__main__':
    main()
