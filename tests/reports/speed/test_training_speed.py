"""The training timings, in miniature."""

import numpy as np
import pytest
import tensorflow as tf

from reports.speed import original_style, training_speed
from tests.learning_to_simulate import synthetic

SMALL = {'latent_size': 8, 'mode_edges': 5}


@pytest.fixture(autouse=True)
def eagerly():
    """Saves the compilation; the times mean nothing here."""
    tf.config.run_functions_eagerly(True)
    yield
    tf.config.run_functions_eagerly(False)


def test_ways_of_listing_pairs_agree():
    appended, at_once = original_style.appended_pairs(5), original_style.numpy_pairs(5)
    assert set(zip(*appended, strict=True)) == {(i, j) for i in range(5) for j in range(5)}
    np.testing.assert_array_equal(appended, at_once)


def test_original_step_learns_what_is_there_to_learn(tmp_path):
    """Targets of unit spread: a network that knows nothing has a loss of about 1 for motion and
    some for force (3.0 together, measured); with noise left in the target it was 17."""
    step = training_speed.original_step(synthetic.write_dataset(tmp_path), 2, latent_size=8)
    assert 0.3 < np.mean([step() for _ in range(10)]) < 5


def test_original_step_changes_its_batch_and_all_methods_have_a_ratio(tmp_path):
    folder = synthetic.write_dataset(tmp_path)
    step = training_speed.original_step(folder, 2, latent_size=8)
    losses = [step() for _ in range(5)]
    assert np.isfinite(losses).all() and len(set(losses)) == 5
    rows = training_speed.measure(folder, batch_size=2, rounds=1, steps=2, **SMALL)
    assert [row['method'] for row in rows] == [
        'original way', 'original way, pairs made by numpy', 'fcg_original', 'pcg',
    ]  # fmt: skip
    assert rows[0]['times_original'] == 1 and all(row['samples_per_s'] > 0 for row in rows)


def test_time_to_error_says_when_it_is_not_reached(tmp_path):
    folder = synthetic.write_dataset(tmp_path)
    short = SMALL | {'num_steps': 3, 'unroll_steps': 0}
    for target, seconds in ((0.0, type(None)), (np.inf, float)):
        row = training_speed.time_to_error(folder, 'pcg', target, budget=100.0, **short)
        assert isinstance(row['seconds'], seconds) and row['steps'] == row['curve'][-1][1] == 3
