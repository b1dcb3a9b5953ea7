"""The stability report in miniature, and the altered runs that it is made of."""

import json
import math

import numpy as np
import pytest

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from reports.stability import cases, extrapolation_cases, nri_cases, shipped, solver_cases
from reports.stability import report as stability_report


@pytest.fixture(scope='module')
def wheel():
    return shipped.load('wheel', 'pcg', 2)


@pytest.fixture(scope='module')
def excavation():
    return shipped.load('excavation', 'pcg')


def test_outcome_follows_figure_and_threshold():
    outcomes = [cases.judged('p', 'n', figure, 'm', 1.0).outcome for figure in (0.5, 1.5, math.nan)]
    assert outcomes == [cases.HOLDS, cases.FAILS, cases.FAILS]
    assert cases.judged('p', 'n', 7.0, 'm').outcome == cases.MEASURED
    assert cases.to_json({'a': np.array([1.0, np.nan]), 'b': (1, 'x')}) == {
        'a': [1.0, None], 'b': [1, 'x'],
    }  # fmt: skip


def test_to_and_fro_turns_at_both_ends():
    assert shipped.to_and_fro(4, 9).tolist() == [0, 1, 2, 3, 2, 1, 0, 1, 2]
    assert shipped.hold(3, 5).tolist() == [0, 1, 2, 2, 2]


def test_blade_out_of_the_grid_is_the_blade_of_the_records_inside_it(excavation):
    group = excavation.group
    for run, record in enumerate(group.record):
        case = excavation.metadata['cases']['test'][int(record)]
        points = extrapolation_cases.blade_points(case, group.position.shape[1])
        built = extrapolation_cases.blade_group(excavation, points)
        body = group.position[run, :, : group.n_rigid]
        # float32 records of about 0.6 m.
        np.testing.assert_allclose(built.position[0, :, : group.n_rigid], body, atol=2e-7)


def test_wheel_at_its_own_speed_is_the_wheel_of_the_records(wheel):
    built = extrapolation_cases.wheel_group(wheel)
    n = built.n_rigid
    np.testing.assert_allclose(built.position[0, :, :n], wheel.group.position[0, :, :n], atol=2e-6)
    faster = extrapolation_cases.wheel_group(wheel, travel=2.0)
    np.testing.assert_array_equal(faster.position[:, :H, n:], built.position[:, :H, n:])
    steps = [np.diff(g.position[0, :, :n].mean(axis=1), axis=0)[H + 5, 0] for g in (built, faster)]
    assert steps[1] == pytest.approx(2 * steps[0], rel=1e-6)


def test_bound_of_the_leapfrog_is_met_and_nearly_reached():
    """One spring of the highest frequency: the closed form of the swing, not a loose bound."""
    for stiffness in (0.01, 0.2, 0.6):
        drift = nri_cases.energy_drift(stiffness, 500)
        assert 0.1 * nri_cases.swing_bound(stiffness) < drift
        assert drift <= nri_cases.swing_bound(stiffness) * (1 + 1e-9)


@pytest.mark.slow
def test_report_in_miniature(tmp_path, monkeypatch):
    """All parts on the smallest cases: every promise holds, and table, JSON and pictures agree."""
    monkeypatch.setattr(shipped, 'SCENES', ('excavation',))
    monkeypatch.setattr(solver_cases, 'STIFFNESS', (0.1, 1.0))
    monkeypatch.setattr(solver_cases, 'GRAVITIES', (0.0, 100.0))
    parts = list(stability_report.PARTS)
    rows = stability_report.report(parts, True, str(tmp_path))
    assert {row.outcome for row in rows} >= {cases.HOLDS, cases.REFUSED, cases.FLAGGED}
    assert not [row.name for row in rows if row.outcome == cases.FAILS]
    values = json.loads((tmp_path / stability_report.DATA).read_text())
    assert [row['name'] for row in values['rows']] == [row.name for row in rows]
    text = (tmp_path / stability_report.REPORT).read_text()
    assert all(row.name in text for row in rows)
    for picture in tmp_path.glob('*.png'):
        assert f']({picture.name})' in text
    assert len(list(tmp_path.glob('*.png'))) == 7  # no predicted body here
    flagged = [row for row in rows if row.outcome == cases.FLAGGED and 'speed_m_s' in row.name]
    # 0.1875, 0.225 and 0.3 m/s, where training ends at 0.15.
    assert len(flagged) == 3


def test_unknown_part_is_refused(tmp_path):
    with pytest.raises(ValueError, match="unknown parts \\['weather'\\]"):
        stability_report.report(['weather'], True, str(tmp_path))
