"""The latency command on a shipped model, in miniature."""

import pathlib
import subprocess
import sys
import time

import pytest

from pca_tools import files
from reports.speed import step_latency

ROOT = pathlib.Path(__file__).resolve().parents[3]
PAIR = 'models/excavation/pcg:datasets/excavation'


def test_command_times_whole_runs_and_writes_them(tmp_path):
    command = [sys.executable, '-m', 'reports', 'step_latency', PAIR, '--steps=1', '--rate_hz=0']
    path = str(tmp_path / 'rows.json')
    done = subprocess.run(
        [*command, f'--output_path={path}'], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith('| models/excavation/pcg')
    document = files.read_json(path)
    (row,) = document['rows']
    assert 'step_latency' in document['command'] and document['machine']['threads'] == 1
    assert row['steps'] == 315  # one whole run
    times = [row[f'ms_{k}'] for k in ('min', 'median', 'p95', 'p99', 'worst')]
    assert times == sorted(times) and times[0] > 0


def test_a_rate_is_kept():
    """A lower bound: sleeping longer is allowed, stepping faster is not."""
    timed = step_latency.Timed(PAIR, rate_hz=500)
    start = time.perf_counter()
    seconds = timed()
    assert time.perf_counter() - start >= 314 / 500 and len(seconds) == 315


def test_a_pair_without_a_dataset_is_a_message():
    with pytest.raises(ValueError, match='not "model folder:dataset folder"'):
        step_latency.Timed('models/excavation/pcg')
