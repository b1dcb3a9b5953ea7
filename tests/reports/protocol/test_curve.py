"""Curves from what a training logs, and their flatness: on known events."""

import pytest
import tensorflow as tf

from reports.protocol import curve, tables


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
    assert curve.of_training(folder) == [
        {'step': 10, 'soil_mse': 4.0, 'force_mse': 1.0},
        {'step': 20, 'soil_mse': 2.5, 'force_mse': None},
        {'step': 30, 'soil_mse': 2.0, 'force_mse': 3.0},
    ]


def test_flatness_compares_the_last_two_quarters():
    points = [{'soil_mse': float(v), 'force_mse': None} for v in (90, 70, 50, 30, 10, 10, 4, 6)]
    assert curve.change(points, 'soil_mse') == pytest.approx(0.5)
    assert curve.change(points, 'force_mse') is None
    assert curve.change(points[:7], 'soil_mse') == pytest.approx(0.4)  # quarters of one


def test_too_few_looks_say_nothing_of_flatness():
    assert curve.change([{'soil_mse': 1.0}] * 3, 'soil_mse') is None


def test_the_table_has_a_row_for_each_training_that_was_watched():
    points = [{'step': n, 'soil_mse': 8.0 / n, 'force_mse': 4.0} for n in (1, 2, 4, 8)]
    seeds = [{'seed': 0, 'curve': points}, {'seed': 1, 'curve': []}, {'seed': 2}]
    document = {'methods': [{'name': 'pcg', 'seeds': seeds}]}
    lines = tables.training_table(document).splitlines()
    assert lines[2:] == ['| pcg | 0 | 8 | 0.5 | 1 |']
    assert tables.training_table({'methods': [{'name': 'pcg', 'seeds': seeds[1:]}]}) == ''
