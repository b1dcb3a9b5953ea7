"""What the decisions are worth, in miniature."""

import numpy as np

from reports import alternatives
from tests.learning_to_simulate import synthetic


def test_alternatives_are_trained_and_tabulated(tmp_path):
    folder = synthetic.write_dataset(tmp_path / 'data')
    short = {'latent_size': 8, 'num_steps': 5, 'unroll_steps': 0, 'mode_edges': 5}
    rows = [alternatives.measure(folder, 'a -> b', short, str(tmp_path / 'work'))]
    text = alternatives.markdown(rows)
    assert 'a -> b' in text and 'nan' not in text
    assert np.isfinite(rows[0]['test']['soil_mse'])
