"""Figures over runs and trainings from known errors; what is read of rollouts; a whole scene."""

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest

import learning_to_simulate as lts
from pca_tools import files
from reports.protocol import judge, report, tables
from tests.learning_to_simulate import models
from tests.reports.protocol.known import document


def test_figures_are_of_runs_that_count_and_a_refused_one_is_infinitely_wrong():
    summary = judge.summary(document())
    soil = summary['all']['soil field']['soil_mm']
    assert soil == {'runs': 2, 'mean': [1.5, None], 'median': [1.5, None]}
    assert summary['others']['soil field']['soil_mm']['mean'] == [9.0, 18.0]
    assert summary['others']['mlp_driven'] == {}  # it knows none of these runs
    assert summary['lift']['soil field']['force_relative_l2']['mean'] == [0.3, None]
    assert set(summary) == {'all', 'others', 'grid', 'lift', 'beside'}


def test_columns_hold_four_digits_and_say_what_was_refused():
    rows = [{'soil_mm': 1.23456, 'other': 1.0}, {'soil_mm': None, 'status': 'non_finite'}, {}]
    assert judge._columns(rows) == {'soil_mm': [1.235, None, None], 'refused': [1]}


def test_models_have_a_name_and_folders():
    with pytest.raises(ValueError, match='NAME=FOLDER'):
        judge.folders_of(['a=,'])
    assert judge.folders_of(['a=/b,/c']) == {'a': ['/b', '/c']}


def test_the_status_is_judged_by_the_errors_of_the_frames_that_it_flags():
    rng = np.random.default_rng(0)
    true = rng.normal(size=(26, 3))
    flagged = np.arange(26) >= 13
    off = np.where(flagged, 0.6, 0.2)[:, None] * true
    # The weight of the tool does not matter.
    found = judge.separation((f * (true + off), f * true, flagged) for f in (1.0, 50.0))
    assert found == pytest.approx(
        {'flagged_frames': 0.5, 'error_flagged': 0.6, 'error_inside': 0.2}
    )


class Here:
    """Workers that are this process, which need not import TensorFlow again."""

    def run(self, work, jobs):
        for index, job in enumerate(jobs):
            work(job)
            yield SimpleNamespace(index=index, error=None)


@pytest.mark.slow
def test_a_scene_with_a_soil_field_and_a_network_is_judged_on_the_same_runs(
    trained_field, tmp_path, monkeypatch
):
    field, data = trained_field
    values = SimpleNamespace(
        data_path=','.join(data), model=[f'soil field={field}', f'mlp={tmp_path}/mlp'],
        work_path='work', num_processes=2, output_path=f'{tmp_path}/judged.json',
    )  # fmt: skip
    monkeypatch.chdir(tmp_path)  # the folder of the work may be relative
    monkeypatch.setattr(judge.workers, 'start', lambda *_: contextlib.nullcontext(Here()))
    monkeypatch.setattr(judge, 'import_tensorflow', lambda _: None)
    with models.eagerly():
        lts.train(lts.preset('mlp', num_steps=6), lts.Dataset(data[0]), str(tmp_path / 'mlp'))
        report.main(values)
    found = files.read_json(values.output_path)
    assert [run['case'] for run in found['runs']] == ['2', '5']
    methods = {m['name']: m['seeds'][0]['errors'] for m in found['methods']}
    own = {'path ridge', 'earthmoving', '3D-RFT', '3D-RFT, fitted', 'persistence'}
    assert set(methods) == {'soil field', 'mlp'} | own
    assert methods['mlp']['soil_mm'][1] is None and methods['soil field']['soil_mm'][1] > 0
    # What stays still is measured alike by both evaluations.
    folder = next((tmp_path / 'work/rollouts/0').glob('mlp_*/test'))
    other = files.read_json(str(folder / 'metrics.json'))['runs']['stay_still'][0]
    assert methods['persistence']['force_relative_l2'][0] == pytest.approx(
        other['force_relative_l2'], rel=1e-3
    )
    assert 'soil field' in tables.methods(values.output_path)


def test_a_model_that_fails_is_named_when_the_others_are_done(tmp_path):
    with pytest.raises(
        ValueError, match=f'1 of 1 models failed:\n{tmp_path}/none: FileNotFoundError'
    ):
        judge.make_all([(str(tmp_path), f'{tmp_path}/none', None, str(tmp_path / 'out'))], 1)


def test_other_runs_have_another_digest(tmp_path):
    for name, text in (('a', 'one'), ('b', 'two')):
        (tmp_path / name).mkdir()
        (tmp_path / name / 'test.tfrecord').write_text(text)
    a, b = f'{tmp_path}/a', f'{tmp_path}/b'
    found = [judge.digest(path, 'test') for path in (a, b, f'{a},{b}', f'{b},{a}')]
    assert len(set(found)) == 4
    (tmp_path / 'b' / 'test.tfrecord').write_text('one')
    assert judge.digest(b, 'test') == found[0]


def variant(cell, draft, surface=0):
    return {
        'force': [[draft, 0.0, 0.0]] * 3, 'surface': [[surface, surface]] * 2, 'cell_m': [cell] * 3,
        'density': 1.0,
    }  # fmt: skip


def test_errors_are_against_cubic_cells_and_the_limit_of_fine_ones(tmp_path, monkeypatch):
    # A draft of 100 N that grows with the 1.5th power of the cell.
    of = {cell: 100.0 * (1.0 + cell**1.5) for cell in (1.0, 1.5, 2.0)}
    runs = {
        'base': variant(1.0, of[1.0], 300),
        'cubic': variant(1.0, 160.0),
        'cells_1.5': variant(1.5, of[1.5]),
        'cells_2': variant(2.0, of[2.0]),
    }
    path = str(tmp_path / 'ladder.json')
    files.write_json(path, {'cases': {'excavation:22': runs, 'wheel:122': {}}})
    monkeypatch.setattr(judge, 'LADDER', path)
    found = judge.truth_errors('blade')
    assert found['cases'] == ['excavation:22'] and found['surface_mm'] == [3.0]
    assert found['force_relative_l2'] == [0.25]  # 200 N where cubic cells have 160
    np.testing.assert_allclose(found['drawbar_relative_l2'], [1.0], rtol=1e-3)
    with pytest.raises(KeyError):
        judge.truth_errors('spoon')
