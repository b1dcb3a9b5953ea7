"""The two proofs of NRI, in miniature."""

import numpy as np
import pytest

from reports.edges import nri_proof, nri_stiffness
from tests.nri import small


def test_proof_simulates_trains_measures_and_draws(tmp_path):
    config = nri_proof.NriConfig(**small.TINY, epochs=2)
    counts = {'train': 32, 'valid': 16, 'test': 16}
    result = nri_proof.run('springs', 3, str(tmp_path), counts, config)
    assert [row['epoch'] for row in result['curve']] == [1, 2]
    assert 0.5 <= result['test_accuracy'] <= 1 and result['runs'] == counts
    nri_proof.draw(result, str(tmp_path / 'curve.png'))
    assert (tmp_path / 'curve.png').read_bytes().startswith(b'\x89PNG')


def test_every_system_has_settings():
    for system, n_objects in nri_proof.PUBLISHED:
        counts, config = nri_proof.settings_of(system, n_objects)
        assert counts['train'] >= 10000 and config.decay_start < config.epochs
        # Only charges act on each other whatever their type.
        assert config.skip_first == (system != 'charged')


def test_stiffness_rows_hold_the_refusal_above_the_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(nri_stiffness, 'STIFFNESSES', (0.01, 0.81))
    monkeypatch.setattr(nri_stiffness, 'TRAIN_RUNS', 100)
    monkeypatch.setattr(nri_stiffness, 'TEST_RUNS', 50)
    rows = nri_stiffness.measure(epochs=1)
    assert 'must be below 2' in rows[1]['refused'] and 'accuracy' not in rows[1]
    assert rows[0]['energy_drift'] < 0.01 and np.isfinite(rows[0]['accuracy'])
    text = nri_stiffness.table(rows)
    assert '| 0.81 | 2.01 | refused |  |  |' in text
    nri_stiffness.draw(rows, str(tmp_path / 'table.png'))
    assert (tmp_path / 'table.png').read_bytes().startswith(b'\x89PNG')


@pytest.mark.parametrize('stiffness', [r for r in nri_stiffness.STIFFNESSES if r < 0.8])
def test_energy_does_not_drift_at_any_stiffness_that_is_measured(stiffness):
    drift, swing = nri_stiffness.energy_errors(stiffness, n_steps=2000, n_run=20)
    assert drift <= 0.01 and swing >= drift
