"""The latency command on a shipped model, in miniature."""

import time

import pytest

from pca_tools import files
from run_scripts import step_latency

PAIR = 'models/excavation/pcg:datasets/excavation'


def test_times_are_ordered_and_written(tmp_path):
    (row,) = step_latency.measure([PAIR], steps=1)
    assert row['steps'] == 315  # one whole run
    times = [row[f'ms_{k}'] for k in ('min', 'median', 'p95', 'p99', 'worst')]
    assert times == sorted(times) and times[0] > 0
    files.write_json(str(tmp_path / 'rows.json'), [row])
    assert files.read_json(str(tmp_path / 'rows.json')) == [row]


def test_a_rate_is_kept():
    """A lower bound: sleeping longer is allowed, stepping faster is not."""
    timed = step_latency.Timed(PAIR, rate_hz=500)
    start = time.perf_counter()
    timed.run(0)
    assert time.perf_counter() - start >= 314 / 500 and len(timed.seconds) == 315


def test_a_pair_without_a_dataset_is_a_message():
    with pytest.raises(ValueError, match='not "model folder:dataset folder"'):
        step_latency.Timed('models/excavation/pcg')
