"""Random calls, hostile values and long runs, under the sanitizers of the compiler."""

import os
import subprocess

import numpy as np
import pytest

from learning_to_simulate.native import library, soil_data
from learning_to_simulate.native.binding import CSubspace
from tests.learning_to_simulate import models
from tests.learning_to_simulate.native import worlds

pytestmark = worlds.needs_c
HERE = os.path.dirname(os.path.abspath(__file__))
CALLS = 100_000
CASES = {
    'prescribed': {},
    'driven': {'motion': 'driven', 'context': True, 'overrides': {'message_passing_steps': 2}},
    'predicted': {'motion': 'predicted', 'preset': 'pcg_thesis', 'rigid_counts': (6,)},
    'mlp': {'preset': 'mlp', 'contact': True, 'overrides': {'mode_edges': 0}},
}


def sanitized(folder, sources, defines, flags=()):
    """Compiles a program with the sources of a project under address and undefined sanitizers."""
    program = os.path.join(folder, 'program')
    files = [os.path.join(folder, 'src', f) for f in os.listdir(os.path.join(folder, 'src'))]
    command = [
        *library.compiler(), '-std=c99', '-O1', '-g', '-fsanitize=address,undefined',
        '-fno-sanitize-recover=all', '-Wall', '-Wextra', '-Werror', f'-I{folder}/include',
        f'-I{folder}/src', *(f'-D{d}' for d in defines), *flags,
        *sorted(f for f in files if f.endswith('.c')), *sources, '-o', program, '-lm',
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True)
    if 'cannot find' in done.stderr and 'asan' in done.stderr:
        pytest.skip('the compiler has no sanitizers')
    assert done.returncode == 0, done.stderr[-3000:]
    return program


def _fuzz(folder, values, program_name, calls=CALLS):
    worlds.written(folder, 'lts_small', values)
    program = sanitized(
        str(folder),
        [os.path.join(HERE, program_name)],
        ['FUZZ_MODEL=lts_small', 'FUZZ_HEADER="lts_small.h"'],
    )
    for seed in ('1', '2'):
        done = subprocess.run([program, seed, str(calls // 2)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr[-3000:]
        good, refused = (int(done.stdout.split()[i]) for i in (0, 2))
        # Neither kind of call may be rare, or the test would see one side only.
        assert good > calls // 10 and refused > calls // 20


@pytest.mark.parametrize('case', CASES.values(), ids=CASES)
def test_random_calls_and_hostile_values_under_sanitizers(case, tmp_path):
    values = worlds.graph(tmp_path / 'data', **case).values
    _fuzz(tmp_path / 'project', values, 'fuzz_calls.c')


@pytest.mark.parametrize('tool', ['blade', 'wheel'])
def test_random_calls_of_a_soil_field_under_sanitizers(tool, tmp_path):
    values = soil_data.values(
        worlds.soil_field(tool, {'load': (6, 5), 'surface': (6,), 'soil': (5,)})
    )
    _fuzz(tmp_path / 'project', values, 'fuzz_soil.c', CALLS // 5)


def test_a_long_run_neither_grows_nor_drifts(tmp_path):
    """The same pose for 50,000 frames: the state keeps its size and stays finite."""
    model, (group, *_), _ = models.make(tmp_path, preset='mlp', overrides={'mode_edges': 0})
    stepper = CSubspace.of(model, group.n_rigid)
    stepper.reset(group.position[0, :6])
    size, pose = len(stepper.save()), group.position[0, 6, : group.n_rigid]
    for _ in range(50_000):
        frame = stepper.step(pose)
    assert len(stepper.save()) == size and np.isfinite(frame.force).all()
