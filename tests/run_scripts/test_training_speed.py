"""The training timings, in miniature."""

import numpy as np
import pytest
import tensorflow as tf

from run_scripts import training_speed
from tests.learning_to_simulate import synthetic

SMALL = {'latent_size': 8, 'mode_edges': 5}


@pytest.fixture(autouse=True)
def eagerly():
    """Saves the compilation; the times mean nothing here."""
    tf.config.run_functions_eagerly(True)
    yield
    tf.config.run_functions_eagerly(False)


def test_original_step_changes_its_batch_and_all_methods_have_a_ratio(tmp_path):
    folder = synthetic.write_dataset(tmp_path)
    step = training_speed.original_step(folder, 2, latent_size=8)
    losses = [step() for _ in range(5)]
    assert np.isfinite(losses).all() and len(set(losses)) == 5
    rows = training_speed.measure(folder, batch_size=2, rounds=1, steps=2, **SMALL)
    assert [row['method'] for row in rows] == ['original way', 'fcg_original', 'pcg']
    assert rows[0]['times_original'] == 1 and all(row['samples_per_s'] > 0 for row in rows)


def test_time_to_error_says_when_it_is_not_reached(tmp_path):
    folder = synthetic.write_dataset(tmp_path)
    short = SMALL | {'num_steps': 3, 'unroll_steps': 0}
    for target, seconds in ((0.0, type(None)), (np.inf, float)):
        row = training_speed.time_to_error(folder, 'pcg', target, budget=100.0, **short)
        assert isinstance(row['seconds'], seconds) and row['steps'] == row['curve'][-1][1] == 3
