"""The figures that are read from a run, on made-up forces, and pairs of runs on a coarse scene."""

import numpy as np
import pytest

from mpm import scenes
from mpm.simulation import Settings
from mpm.verification import run_rows
from tests.mpm import small


@pytest.mark.parametrize('share', [0.0, 0.02, 0.2])
def test_saw_tooth_finds_a_tone_under_a_trend(share):
    """8 cm/s over cells of 13.3 mm: 6 Hz, on a draft that grows, beside one of 2 Hz."""
    t = np.arange(240) / 60
    force = 50.0 + 30.0 * t + 5.0 * np.sin(2 * np.pi * 2.0 * t)
    force += share * 110.0 * np.sin(2 * np.pi * 6.0 * t + 0.7)
    found = run_rows.saw_tooth(force, 0.08, 0.8 / 60)
    assert found == pytest.approx(share * 110.0 / force.mean(), abs=1e-3)


@pytest.mark.parametrize('case', run_rows.SAW_TOOTH_CASES)
def test_cutting_is_at_constant_speed_and_about_level(case):
    parameters = scenes.EXCAVATION.parameters(case)
    frames = run_rows.cutting_frames(parameters, scenes.FRAMES)
    assert len(frames) > 60 and (np.diff(frames) == 1).all()
    pose = run_rows.path_of(parameters)[frames]
    slope = np.abs(np.diff(pose[:, 1]) / np.diff(pose[:, 0]))
    assert slope.max() < 0.36
    way = -np.diff(pose[:, 0]) * 60
    np.testing.assert_allclose(way, parameters['speed_m_s'], rtol=1e-6)


def test_pairs_tell_what_changes():
    (step,) = run_rows.halved_step(small.BLADE, 186, 25)
    assert 0.0 < abs(step.figure) < 0.01 and step.passed and '25 frames' in step.note
    rows = run_rows.short_cut('sleep', small.BLADE, 186, 12)
    assert [row.passed for row in rows] == [True, True]
    rows = run_rows.noise(small.BLADE, 186, 12)
    assert [row.expected for row in rows] == [None, None]
    assert 0.0 < abs(rows[0].figure) < 1e-4 and rows[1].figure < 1e-3


def test_steps_in_single_precision_change_a_run_by_rounding_alone():
    """Against the same kernels in float64: not equal, and not more apart than rounding explains."""
    force, simulation = run_rows.drive(small.BLADE, 186, 12, Settings())
    exact, other = run_rows.drive(small.BLADE, 186, 12, Settings(single=False))
    apart = np.abs(simulation.positions() - other.positions()).max()
    assert 0.0 < apart < 2e-6  # m; measured 1e-7
    assert np.abs(force - exact).max() < 2e-4 * np.abs(exact).max()
