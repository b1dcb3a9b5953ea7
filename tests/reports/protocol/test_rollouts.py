"""Flags of trainings, and what trainings log."""

import pytest
import tensorflow as tf

from pca_tools import files
from reports.protocol import rollouts


def log(folder, rows):
    """Writes (step counted from 0, soil, force) as the training loop does, to a file of its own."""
    with tf.summary.create_file_writer(folder).as_default():
        for step, soil, force in rows:
            tf.summary.scalar('loss', 1.0, step=step)
            tf.summary.scalar('rollout_error_mse', soil, step=step)
            tf.summary.scalar('force_error_mse', force, step=step)


def test_a_curve_is_what_was_logged_last_at_each_step(tmp_path):
    folder = str(tmp_path)
    log(folder, [(9, 4.0, 1.0), (19, 3.0, 2.0)])
    log(folder, [(19, 2.5, float('nan')), (29, 2.0, 3.0)])  # killed after step 20, begun at 10
    assert rollouts.curve(folder) == [
        {'step': 10, 'soil_mse': 4.0, 'force_mse': 1.0},
        {'step': 20, 'soil_mse': 2.5, 'force_mse': None},
        {'step': 30, 'soil_mse': 2.0, 'force_mse': 3.0},
    ]


def test_trainings_differ_in_their_seed_where_anything_is_drawn():
    last = '--num_threads=1'
    assert rollouts.trainings('mlp --modes=8', 2, 'work') == [
        (f'work/mlp_modes_8_{i}', ['--preset=mlp', '--modes=8', f'--seed={i}', last])
        for i in (0, 1)
    ]
    (_, (_, first, *_)), (_, (_, second, *_)) = rollouts.trainings('pcg --adjacency={seed}', 2, '')
    assert (first, second) == ('--adjacency=0', '--adjacency=1')
    # A regression draws nothing: it is trained once, and is given no seed, which it would refuse.
    assert rollouts.trainings('path_ridge', 2, '') == [
        ('path_ridge_0', ['--preset=path_ridge', last])
    ]
    for bad in ('', 'mlp modes=8', '--modes=8'):
        with pytest.raises(ValueError, match='--FLAG=VALUE'):
            rollouts.trainings(bad, 1, '')


def test_rows_that_are_not_the_records_are_refused(tmp_path):
    rows = [{'record': 0, 'soil_mm': 1.0, 'force_rmse': 2.0}, {'record': 2}]
    files.write_json(str(tmp_path / 'metrics.json'), {'runs': {'model': rows}})
    with pytest.raises(ValueError, match='metrics.json: runs are not the records'):
        rollouts.read(str(tmp_path))
    files.write_json(str(tmp_path / 'metrics.json'), {'runs': {'model': rows[:1]}})
    assert rollouts.read(str(tmp_path)) == [{'soil_mm': 1.0, 'force_n': 2.0}]
    assert rollouts.read(str(tmp_path), said=('force',)) == [{'force_n': 2.0}]
