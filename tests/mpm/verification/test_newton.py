"""What is compared with Newton, on made-up forces and surfaces; Newton itself is not needed."""

import importlib.metadata
import json
import sys

import numpy as np
import pytest

from mpm import run, scenes
from mpm.verification import newton


def made_up(case=146, named=None, **changes):
    """A run of a case without force."""
    parameters = scenes.EXCAVATION.parameters(case) | {
        'case': named or case, 'rheology': 'local', 'solver_version': '4', **changes,
    }  # fmt: skip
    zeros = np.zeros((scenes.FRAMES, 3), dtype=np.float32)
    return run.RawRun(zeros[:, None], zeros[:, None], zeros, parameters)


def test_forces_are_compared_in_the_window_alone():
    ours, theirs = np.zeros((10, 3)), np.zeros((10, 3))
    ours[4:8, 0], theirs[4:8, 0] = 100.0, [70.0, 90.0, 70.0, 90.0]
    theirs[:4], theirs[4:8, 1] = 1e9, -5.0
    found = newton.compare_forces(ours, theirs, np.arange(4, 8))
    assert found == pytest.approx(
        {
            'draft_N': 80.0,
            'draft_ratio': 0.8,
            'draft_rms_over_mean': np.sqrt(0.05),
            'vertical_N': -5.0,
        }
    )


def test_surfaces_are_compared_where_one_of_them_moved():
    start = np.full((4, 5), 0.25)
    ours, theirs = start.copy(), start.copy()
    ours[0], theirs[1], theirs[2] = 0.28, 0.29, 0.254  # the last is less than what counts
    found = newton.compare_surfaces(start, ours, theirs)
    assert found == pytest.approx(
        {
            'surface_rms_mm': np.sqrt((30**2 + 40**2 + 4**2) / 4),
            'surface_rms_moved_mm': np.sqrt((30**2 + 40**2) / 2),
            'moved_by_rms_mm': np.sqrt(30**2 / 2),
            'heap_mm': 40.0,
            'heap_ours_mm': 30.0,
        }
    )
    assert newton.compare_surfaces(start, start, start)['surface_rms_moved_mm'] == 0.0
    assert newton.profile(theirs) == [150.0, 190.0, 154.0, 150.0]


def test_runs_that_do_not_compare_are_refused():
    assert newton.checked(made_up(), 60)
    with pytest.raises(ValueError, match="run 'lift_0003' is no case"):
        newton.checked(made_up(named='lift_0003'), 60)
    with pytest.raises(ValueError, match="the law 'nonlocal'"):
        newton.checked(made_up(rheology='nonlocal'), 60)
    with pytest.raises(ValueError, match='does not cut in its first 40 frames'):
        newton.checked(made_up(123), 40)  # it goes down its ramp for two seconds


def test_a_file_of_another_run_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.metadata, 'version', lambda name: '1.0')
    path = tmp_path / 'newton.json'
    new = newton.opened(str(path), made_up(), 60)
    assert new['case'] == 146 and new['rows'] == {}
    path.write_text(json.dumps(new))
    assert newton.opened(str(path), made_up(), 60) == new
    with pytest.raises(ValueError, match="compares .*'frames': 60.*name another"):
        newton.opened(str(path), made_up(), 61)
    path.write_text('[1]')
    with pytest.raises(ValueError, match='is not a comparison with Newton'):
        newton.opened(str(path), made_up(), 60)


def test_without_newton_nothing_is_begun(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 'newton', None)
    path = tmp_path / 'newton.json'
    with pytest.raises(ValueError, match='newton is not installed'):
        newton.compare(made_up(), str(tmp_path), str(path), 60, ['base'])
    assert not list(tmp_path.iterdir())


def test_table_and_picture_show_every_variant(tmp_path):
    pytest.importorskip('matplotlib')
    curves = {'force_x_N': [1.0, 2.0], 'profile_mm': [150.0, 151.0, 152.0]}
    figures = {
        'voxel_mm': 20.0, 'step_s': 1 / 120, 'draft_N': 80.0, 'draft_ratio': 0.8,
        'draft_rms_over_mean': 0.25, 'vertical_N': 40.0, 'surface_rms_mm': 2.0,
        'surface_rms_moved_mm': 8.0, 'heap_mm': 30.0, 'heap_ours_mm': 33.0, 'cpu_s': 200,
    }  # fmt: skip
    content = {
        'case': 146,
        'window': [1, 2],
        'ours': {'draft_N': 100.0, 'vertical_N': 50.0} | curves,
        'rows': {name: figures | curves for name in newton.VARIANTS},
    }
    path = tmp_path / 'newton.json'
    path.write_text(json.dumps(content))
    lines = newton.table(str(path)).splitlines()
    assert len(lines) == 3 + len(newton.VARIANTS)
    assert '| Newton, half step | 20.0 | 1/120 | 80 | 0.8 |' in lines[4]
    newton.draw(str(path), str(tmp_path / 'newton.png'))
    assert (tmp_path / 'newton.png').stat().st_size > 10_000
