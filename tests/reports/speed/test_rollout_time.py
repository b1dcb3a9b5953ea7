"""Rollouts timed in turns, in miniature."""

import pytest

from reports.speed import rollout_time
from tests.learning_to_simulate import synthetic


def test_times_have_all_methods_in_one_run(tmp_path, monkeypatch):
    folder = synthetic.write_dataset(tmp_path)
    small = {'partial': {'preset': 'pcg', 'mode_edges': 5}, 'full': {'preset': 'fcg_original'}}
    for overrides in small.values():
        overrides['latent_size'] = 8
    monkeypatch.setattr(rollout_time, 'METHODS', small)
    rows = rollout_time.measure(folder, rounds=3)
    assert [row['edges'] for row in rows] == [4 * 3 + 5, 49, 49, 49]
    assert all(0 < row['ms_min'] <= row['ms_median'] <= row['ms_p95'] for row in rows)


def test_batches_repeat_the_test_runs_and_are_timed_per_run(tmp_path, monkeypatch):
    folder = synthetic.write_dataset(tmp_path)
    small = {'pcg': {'preset': 'pcg', 'mode_edges': 5, 'latent_size': 8}}
    monkeypatch.setattr(rollout_time, 'METHODS', small)
    rows = rollout_time.measure(folder, rounds=2, batch_sizes=[1, 3])  # the split holds 2 runs
    assert [(row['method'], row['batch']) for row in rows] == [('pcg, B = 1', 1), ('pcg, B = 3', 3)]
    with pytest.raises(ValueError, match=r'\[4, 0\], must be at least 1'):
        rollout_time.measure(folder, rounds=1, batch_sizes=[4, 0])
