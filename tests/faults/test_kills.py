"""Kills in a process of their own: it forks before TensorFlow computes anything. One task more than
there are must lose something.

KILLS in the environment is the number of kills at random moments and at named points of each task,
for a long run.
"""

import collections
import os
import subprocess
import sys

import pytest

from pca_tools import files
from tests.pca_tools.commands import REPOSITORY


@pytest.mark.slow
def test_kills_lose_nothing_but_what_is_not_written_whole(tmp_path):
    many = int(os.environ.get('KILLS', '0'))
    moments, points = (many, many) if many else (1, 3)
    command = ['tests.faults.kills', str(tmp_path / 'kills.json'), str(moments), str(points)]
    done = subprocess.run(
        [sys.executable, '-m', *command], cwd=REPOSITORY, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    found = files.read_json(str(tmp_path / 'kills.json'))
    losses = collections.Counter(task for task, *_, lost in found if lost)
    assert losses.keys() == {'broken'}, [row for row in found if row[-1]]
    counts = collections.Counter((task, bool(point)) for task, _, point, _ in found)
    for task, n_points, _, _ in found:
        assert counts[task, False] == moments and counts[task, True] == min(points, n_points)
        assert n_points > 5 or task == 'broken'
