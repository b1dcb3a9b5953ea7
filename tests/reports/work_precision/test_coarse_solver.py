"""The solver on coarser grids, in miniature."""

import dataclasses

import pytest

from learning_to_simulate import metrics
from mpm import raw_run, scenes
from mpm.experiments import coarse
from pca_tools import files
from reports.work_precision import coarse_solver

CASE = 186


@pytest.fixture(scope='module')
def measured(tmp_path_factory):
    """(scene, raw folder, JSON file, summary) of ten frames of a small excavation on two grids."""
    scene, folder = coarse(scenes.EXCAVATION), tmp_path_factory.mktemp('coarse')
    scene = dataclasses.replace(scene, bin=dataclasses.replace(scene.bin, keep_every=4))
    path = str(folder / 'rows.json')
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scenes, 'FRAMES', 10)
        summary = coarse_solver.measure(scene, (CASE,), (1.0, 2.0), str(folder / 'raw'), path)
    return scene, str(folder / 'raw'), path, summary


def test_same_grid_has_no_error_and_coarser_cells_cost_less(measured):
    scene, raw, path, summary = measured
    same, twice = (summary['runs'][f'solver_x{f}'][0] for f in (1, 2))
    assert same['soil_mse'] == same['rigid_mse'] == same['force_relative_l2'] == 0.0
    assert twice['soil_mse'] > 0 and twice['particles'] * 4 == same['particles']
    assert twice['time_step_s'] > 1.9 * same['time_step_s']
    fine = raw_run.read_run(f'{raw}/run_{CASE:03d}.npz')
    cpu = fine.parameters['solver_cpu_s']
    row = summary['runs']['solver'][0]
    assert row['seconds_per_simulated_second'] == pytest.approx(cpu / (9 / 60))
    assert 'soil_mse' not in row
    assert files.read_json(path) == summary
    text = coarse_solver.table(summary)
    assert len(text.splitlines()) == 5 and f'{metrics.rms_mm(twice["soil_mse"]):.3g}' in text


def test_rows_that_are_there_are_not_made_again(measured, monkeypatch):
    scene, raw, path, summary = measured
    monkeypatch.setattr(coarse_solver, 'measure_case', None)
    assert coarse_solver.measure(scene, (CASE,), (1.0, 2.0), raw, path) == summary


def test_bad_choices_are_refused(measured, tmp_path):
    scene, raw, path, _ = measured
    with pytest.raises(ValueError, match='must be at least 1'):
        coarse_solver.measure(scene, (CASE,), (0.5,), raw, str(tmp_path / 'new.json'))
    with pytest.raises(ValueError, match='rows of another scene .excavation there, wheel now'):
        coarse_solver.measure(scenes.WHEEL, (63,), (2.0,), raw, path)


def test_frames_of_a_lead_in_are_paid_for(measured):
    run = raw_run.read_run(f'{measured[1]}/run_{CASE:03d}.npz')
    before = coarse_solver.cost(run)['milliseconds_per_step']
    run.parameters['lead_in_frames'] = 9
    assert coarse_solver.cost(run)['milliseconds_per_step'] == pytest.approx(before / 2)
