"""The project as a user installs it: its wheel in an empty environment, outside of the sources."""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
PACKAGES = 'learning_to_simulate', 'mpm', 'nri', 'pca_tools'
BUILT_FROM = 'setup.py', 'pyproject.toml', 'MANIFEST.in', 'README.md', 'LICENSE', 'models'
CHECKS = """
import pytest
import learning_to_simulate as lts
assert 'venv' in lts.__file__, lts.__file__
assert 'excavation/soil_field' in lts.list() and 'wheel/soil_field' in lts.list()
for name in lts.list():
    assert lts.load(name).path.startswith(lts.__path__[0])
with pytest.raises(FileNotFoundError, match='shipped are .*wheel/soil_field'):
    lts.load('moon')
with pytest.raises(FileNotFoundError, match='installed copy has none: name a folder'):
    lts.Dataset('excavation')
"""


@pytest.fixture(scope='module')
def wheel(tmp_path_factory):
    """The wheel, built from a copy: setuptools writes into the folder that it builds from."""
    source, out = tmp_path_factory.mktemp('source'), tmp_path_factory.mktemp('wheel')
    for name in BUILT_FROM + PACKAGES:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, source / name)
    build = ['wheel', '--quiet', '--no-deps', '--no-build-isolation', '--wheel-dir', out, source]
    subprocess.run([sys.executable, '-m', 'pip', *build], check=True)
    return next(out.glob('*.whl'))


@pytest.fixture(scope='module')
def run(wheel, tmp_path_factory):
    """Runs a program of an environment with the wheel, in an empty folder; returns what it said.

    The dependencies are those of this interpreter, found by a line of their own in a `.pth` file:
    the link to the sources that an editable install made is not followed from there.
    """
    folder = tmp_path_factory.mktemp('installed')
    subprocess.run([sys.executable, '-m', 'venv', '--without-pip', folder / 'venv'], check=True)
    programs = folder / 'venv' / 'bin'
    install = ['--python', programs / 'python', 'install', '--quiet', '--no-deps', wheel]
    subprocess.run([sys.executable, '-m', 'pip', *install], check=True)
    (site,) = folder.glob('venv/lib/python*/site-packages')
    (site / 'dependencies.pth').write_text(sysconfig.get_path('purelib'))
    (folder / 'empty').mkdir()
    environment = {k: v for k, v in os.environ.items() if k != 'PYTHONPATH'}

    def started(program, *arguments):
        done = subprocess.run(
            [programs / program, *arguments], cwd=folder / 'empty', env=environment,
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return started


def test_nothing_generic_is_at_the_top(wheel):
    with zipfile.ZipFile(wheel) as archive:
        tops = {name.split('/')[0] for name in archive.namelist()}
    assert {top for top in tops if not top.endswith('.dist-info')} == set(PACKAGES)
    assert wheel.stat().st_size < 25e6


@pytest.mark.slow
def test_models_come_with_it_and_the_python_of_the_readme_runs(run):
    blocks = re.findall(r'```python\n(.*?)```', (ROOT / 'README.md').read_text(), re.DOTALL)
    own = [block for block in blocks if 'mujoco' not in block]  # the machine's is not installed
    assert own and 'ok' in run('python', '-c', '\n'.join([CHECKS, *own]))


def test_commands(run):
    said = run('lts', '--help')
    assert 'train' in said and 'rollout' in said
    assert 'excavation/soil_field' in run('lts', 'list').split()


@pytest.mark.slow
def test_own_data_by_the_lines_of_the_documents(run):
    """Raw runs by the script of docs/data.md, then the commands of the README, on a few steps of
    the network that needs no height maps."""
    (block,) = re.findall(r'```python\n(.*?)```', (ROOT / 'docs/data.md').read_text(), re.DOTALL)
    run('python', '-c', block)
    (lines,) = re.findall(r'```\n(lts convert.*?)```', (ROOT / 'README.md').read_text(), re.DOTALL)
    steps = '--preset=mlp --num_steps=4 --set=unroll_steps=0'
    said = {}
    lines = lines.replace('=raw ', '=raw/own ').replace('--model=soil_field', steps)
    for line in lines.splitlines():
        said[line.split()[1]] = run(*line.split(), *['--format=png'] * ('render' in line))
    assert list(said) == ['convert', 'inspect', 'train', 'evaluate', 'render']
    assert '5 runs' in said['inspect'] and 'persistence' in said['evaluate']
    assert '.png' in said['render']
