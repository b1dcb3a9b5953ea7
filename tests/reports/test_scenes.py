"""The report of scenes: its table, and the runs that it makes."""

import json

import numpy as np
import pytest

from reports.scenes import report, runs

ROW = {
    'bodies': 1, 'rigid_points': [12, 20], 'dim': 3, 'frames': [60], 'frame_rate': 60.0, 'modes': 8,
    'particles': 1067, 'force': True, 'context': [], 'soil_rms_mm': [2.0, 3.0],
    'persistence_rms_mm': [20.0, 31.0], 'truncation_rms_mm': 1.5, 'force_relative_l2': [0.2, 0.25],
    'persistence_force': [0.9, 0.8], 'weights': 17000, 'edges': [100, 200],
    'edges_left_out': [300, 584], 'status': ['ok', 'ok'], 'ms_per_step': 0.2,
}  # fmt: skip


def test_table_says_what_the_rows_say(tmp_path):
    none = ROW | {'bodies': 0, 'force': False, 'dim': 2, 'ms_per_step': 0.05}
    none |= {'force_relative_l2': [None, None], 'persistence_force': [None, None]}
    path = tmp_path / 'scenes.json'
    path.write_text(json.dumps({'rows': {'widths': ROW, 'column_2d': none}}))
    _, _, one, other = report.table(str(path)).splitlines()
    assert '1: 12, 20' in one and '| 2, 3 | 20, 31 | 1.5 |' in one and '| 1 | 17000 |' in one
    assert '`column_2d` (2-D) | none' in other and '| 0.25 | 17000 |' in other


def test_a_table_without_the_scene_of_time_one_has_no_ratio(tmp_path):
    path = tmp_path / 'scenes.json'
    path.write_text(json.dumps({'rows': {'pair': ROW}}))
    assert '|  | 17000 |' in report.table(str(path))


def test_runs_differ_and_the_test_runs_lie_within():
    values = [runs._between(1.0, 3.0, run) for run in range(len(runs.SPLITS))]
    assert len(set(values)) == 9 and min(values) == 1.0 and max(values) == 3.0
    inside = [v for v, split in zip(values, runs.SPLITS, strict=True) if split != 'train']
    assert min(inside) > 1.0 and max(inside) < 3.0


def test_more_runs_differ_and_have_their_splits():
    values = [[runs._between(1.0, 3.0, run, turn) for turn in (0, 1)] for run in range(9, 63)]
    assert len({v for pair in values for v in pair}) == 108
    assert 1.0 < np.min(values) < 1.1 and 2.9 < np.max(values) < 3.0
    splits = [runs.split_of(run) for run in range(63)]
    assert [splits.count(s) for s in ('train', 'valid', 'test')] == [42, 7, 14]


def test_a_plane_column_falls_off_the_wall_and_keeps_its_particles():
    one, other = runs.column_2d(0), runs.column_2d(1)
    start, end = one['positions'][0], one['positions'][-1]
    np.testing.assert_array_equal(start, other['positions'][0])  # one packing
    assert start.shape[1] == 2 and end[:, 0].max() > start[:, 0].max() + 0.02
    assert end[:, 1].mean() < start[:, 1].mean()
    assert other['positions'][-1, :, 0].mean() > end[:, 0].mean()  # thrown harder


@pytest.mark.parametrize('name', list(report.SCENES))
def test_every_scene_has_its_runs(name):
    assert callable(getattr(runs, name)) and report.SCENES[name]['modes'] > 0
