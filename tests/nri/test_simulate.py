"""`python -m nri.simulate`: names, shapes and contents of the files."""

import numpy as np
import pytest

from nri import particle_systems, simulate
from pca_tools import files
from tests.pca_tools.commands import call_command


def test_files_have_kipfs_names_and_shapes(tmp_path):
    path = tmp_path / 'made'
    command = ['nri.simulate', '--system=charged', '--n_objects=3', '--num_train=7']
    command += ['--num_valid=2', '--num_test=3', '--length=500', f'--output_path={path}']
    refused = call_command(*command, '--dt=0.1')
    assert refused.returncode == 1 and refused.stderr.startswith('error: time step 0.1 is unstable')
    assert not path.exists()
    done = call_command(*command)
    assert done.returncode == 0 and '12 runs of 4 frames' in done.stdout, done.stderr
    for split, count in (('train', 7), ('valid', 2), ('test', 3)):
        for prefix in ('loc', 'vel'):
            array = np.load(path / f'{prefix}_{split}_charged3.npy', allow_pickle=False)
            assert array.shape == (count, 4, 2, 3) and array.dtype == np.float32
        edges = np.load(path / f'edges_{split}_charged3.npy', allow_pickle=False)
        assert edges.shape == (count, 3, 3) and set(np.unique(edges)) <= {-1.0, 1.0}
    assert files.read_json(str(path / 'simulation_charged3.json'))['dt'] == 0.001
    system = particle_systems.Charged(n_objects=3)
    for steps, message in ((500, 'holds'), (200, 'fewer than two frames')):
        with pytest.raises(ValueError, match=message):
            simulate.write_dataset(system, 'charged', {'train': 1}, steps, 100, 0, str(path))


def test_runs_are_a_function_of_seed_and_split():
    system = particle_systems.Springs(n_objects=2, dt=0.02)
    first, again, other, test = (
        simulate.simulate_split(system, 20, 40, 5, seed, split)['loc']
        for seed, split in ((0, 'train'), (0, 'train'), (1, 'train'), (0, 'test'))
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).all() and (first != test).all()
