"""A strip shows one run of each kind; where there is none, the folder is named."""

import numpy as np
import pytest

from mpm import raw_run, scenes
from reports import film_strips


def a_run(case, kind, frames=13):
    """A run of eight particles and a body of two points."""
    positions = np.zeros((frames, 8, 3), np.float32)
    positions[..., :] = np.random.default_rng(0).uniform(0.1, 0.2, (8, 3))
    positions[:, 0, 0] += np.linspace(0.0, 0.05, frames)
    return raw_run.RawRun(
        positions=positions,
        rigid_positions=np.full((frames, 2, 3), 0.15, np.float32),
        force=np.zeros((frames, 3), np.float32),
        parameters={'case': case, 'kind': kind},
    )


def test_first_run_of_each_kind_is_drawn(tmp_path):
    runs = [a_run('lift_3', 'lift'), a_run('lift_0', 'lift'), a_run('stops_1', 'stops')]
    entries = [raw_run.write_run(str(tmp_path), run) for run in runs]
    raw_run.write_manifest(str(tmp_path), scenes.EXCAVATION, entries)
    found = film_strips.first_of_each_kind(str(tmp_path))
    assert {k: v.rsplit('/', 1)[1] for k, v in found.items()} == {
        'lift': 'run_lift_0.npz',
        'stops': 'run_stops_1.npz',
    }
    drawn = tmp_path / 'strips.png'
    film_strips.draw({k: raw_run.read_run(path) for k, path in found.items()}, str(drawn))
    assert drawn.read_bytes()[:4] == b'\x89PNG'


def test_folder_without_runs_is_named(tmp_path):
    with pytest.raises(ValueError, match='no finished raw runs'):
        film_strips.first_of_each_kind(str(tmp_path))
