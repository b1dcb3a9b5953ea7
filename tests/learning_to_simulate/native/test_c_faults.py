"""Random calls, hostile values and long runs, under the sanitizers of the compiler."""

import glob
import os
import subprocess

import pytest

from learning_to_simulate.native import library, soil_data
from tests.learning_to_simulate.native import worlds

pytestmark = worlds.needs_c
HERE = os.path.dirname(os.path.abspath(__file__))
CALLS = 30_000
CASES = {
    'driven': {'motion': 'driven', 'context': True, 'overrides': {'message_passing_steps': 2}},
    'predicted': {'motion': 'predicted', 'preset': 'pcg_thesis', 'rigid_counts': (6,)},
    'mlp': {'preset': 'mlp', 'contact': True, 'overrides': {'mode_edges': 0}},
}


def compiler():
    return [
        *library.compiler(), '-std=c99', '-O1', '-g1', '-fsanitize=address,undefined',
        '-fno-sanitize-recover=all', '-Wall', '-Wextra', '-Werror',
    ]  # fmt: skip


@pytest.fixture(scope='module')
def objects(tmp_path_factory):
    """The library, which all programs share, under address and undefined sanitizers."""
    folder, parts = tmp_path_factory.mktemp('objects'), library.parts_of(library.SOURCES)
    sources = sorted(glob.glob(f'{parts[1]}/*.c'))
    subprocess.run([*compiler(), '-c', *(f'-I{part}' for part in parts), *sources], cwd=folder,
                   check=True)  # fmt: skip
    return sorted(map(str, folder.glob('*.o')))


def _fuzz(folder, values, objects, program_name, calls=CALLS):
    worlds.written(folder, 'lts_small', values)
    program = str(folder / 'program')
    done = subprocess.run(
        [*compiler(), f'-I{folder}/include', f'-I{folder}/src', '-DFUZZ_MODEL=lts_small',
         '-DFUZZ_HEADER="lts_small.h"', f'{folder}/src/lts_small.c', *objects,
         os.path.join(HERE, program_name), '-o', program, '-lm'], capture_output=True, text=True,
    )  # fmt: skip
    if 'cannot find' in done.stderr and 'asan' in done.stderr:
        pytest.skip('the compiler has no sanitizers')
    assert done.returncode == 0, done.stderr[-3000:]
    for seed in ('1', '2'):
        done = subprocess.run([program, seed, str(calls // 2)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr[-3000:]
        good, refused = (int(done.stdout.split()[i]) for i in (0, 2))
        # Neither kind of call may be rare, or the test would see one side only.
        assert good > calls // 10 and refused > calls // 20


@pytest.mark.parametrize('case', CASES.values(), ids=CASES)
def test_random_calls_and_hostile_values_under_sanitizers(case, objects, tmp_path):
    values = worlds.graph(tmp_path / 'data', **case).values
    _fuzz(tmp_path / 'project', values, objects, 'fuzz_calls.c')


@pytest.mark.parametrize('tool', ['blade', 'wheel'])
def test_random_calls_of_a_soil_field_under_sanitizers(tool, objects, tmp_path):
    values = soil_data.values(worlds.soil_field(tool, worlds.TINY))
    _fuzz(tmp_path / 'project', values, objects, 'fuzz_soil.c', CALLS // 5)
