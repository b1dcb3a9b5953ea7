"""`python -m nri.simulate`: names, shapes and contents of the files."""

import numpy as np
import pytest

from nri import particle_systems, simulate
from pca_tools import files
from tests.pca_tools.commands import run_command


def test_files_have_kipfs_names_and_shapes(tmp_path):
    command = ['nri.simulate', '--system=charged', '--n_objects=3', '--num_train=7']
    command += ['--num_valid=2', '--num_test=3', '--length=500', f'--output_path={tmp_path}']
    done = run_command(*command)
    assert done.returncode == 0, done.stderr
    assert '12 runs of 4 frames' in done.stdout
    for split, count in (('train', 7), ('valid', 2), ('test', 3)):
        for prefix in ('loc', 'vel'):
            array = np.load(tmp_path / f'{prefix}_{split}_charged3.npy', allow_pickle=False)
            assert array.shape == (count, 4, 2, 3) and array.dtype == np.float32
        edges = np.load(tmp_path / f'edges_{split}_charged3.npy', allow_pickle=False)
        assert edges.shape == (count, 3, 3) and set(np.unique(edges)) <= {-1.0, 1.0}
    assert files.read_json(str(tmp_path / 'simulation_charged3.json'))['dt'] == 0.001
    again = run_command(*command)
    assert again.returncode == 1 and 'holds' in again.stderr and 'Traceback' not in again.stderr


def test_an_unstable_step_is_one_line(tmp_path):
    done = run_command(
        'nri.simulate',
        '--dt=0.1',
        '--interaction_strength=100',
        '--length=500',
        f'--output_path={tmp_path / "new"}',
    )
    assert done.returncode == 1 and done.stderr.startswith('error: time step 0.1 is unstable')
    assert not (tmp_path / 'new').exists()


def test_runs_are_a_function_of_seed_and_split():
    system = particle_systems.Springs(n_objects=2, dt=0.02)
    make = [
        simulate.simulate_split(system, n, 40, 5, seed, split)['loc']
        for n, seed, split in (
            (20, 0, 'train'),
            (20, 0, 'train'),
            (20, 1, 'train'),
            (20, 0, 'test'),
        )
    ]
    np.testing.assert_array_equal(make[0], make[1])
    assert (make[0] != make[2]).all() and (make[0] != make[3]).all()


def test_too_few_frames_are_refused(tmp_path):
    system = particle_systems.Springs()
    with pytest.raises(ValueError, match='fewer than two frames'):
        simulate.write_dataset(system, 'springs', {'train': 1}, 200, 100, 0, str(tmp_path))
