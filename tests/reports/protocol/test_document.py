"""The document of a small dataset, whose models are made here and not in processes of their own."""

import contextlib
import json
import os
import types

import numpy as np
import pytest

from learning_to_simulate import evaluation, presets, registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from pca_tools import dataset, files, workers
from reports import documents, record
from reports.protocol import document, rollouts, tables
from tests.learning_to_simulate import synthetic


def here(flags):
    """What `learning_to_simulate.train` does, in this process."""
    given = dict(flag[2:].split('=') for flag in flags)
    if 'mode' not in given:
        return registry.train(
            given['data_path'], given['model_path'], presets.make_config(given['preset'])
        )
    opened = registry.open_model(given['model_path'], given['data_path'], given['eval_split'])
    results, summary = opened.evaluator.run(opened.groups, given['eval_split'])
    return evaluation.save_rollouts(
        given['output_path'], given['eval_split'], results, summary, opened.metadata
    )


class Crew:
    """Workers that are this process."""

    def run(self, function, jobs):
        for index, job in enumerate(jobs):
            try:
                yield workers.Outcome(index, function(job))
            except ValueError as error:
                yield workers.Outcome(index, None, str(error))


@pytest.fixture(scope='module')
def judged(tmp_path_factory):
    """(folder, document) of runs whose body is driven; `mine` is the baselines' path ridge."""
    work = tmp_path_factory.mktemp('judged')
    folder = synthetic.write_dataset(work / 'data', motion='driven', torque=True)
    synthetic.write_subspace(folder)
    synthetic.write_particles(folder)
    values = types.SimpleNamespace(
        model=[f'mine={work}/models/data/baselines/path_ridge_0'], train=[], work_path=str(work),
        cluster='', num_processes=1,
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rollouts, '_run', here)
        patch.setattr(workers, 'start', lambda *_: contextlib.nullcontext(Crew()))
        return folder, tables.complete(document.protocol(folder, values))


def errors_of(found, name):
    (method,) = (m for m in found['methods'] if m['name'] == name)
    return method['seeds'][0]['runs']['test']


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def test_errors_are_those_worked_out_from_the_records(judged):
    folder, found = judged
    names = [m['name'] for m in found['methods']]
    assert names[:4] == ['persistence', 'constant velocity', 'mean force', 'path ridge']
    assert names[-1] == 'mine' and 'earthmoving' not in names  # that wants a soil's angle
    train, test = (dataset.read_split(folder, split) for split in ('train', 'test'))
    mean = np.concatenate([run.force for run in train]).mean(axis=0)
    for number, run in enumerate(test):
        truth, height = run.force[H:], run.position[:, : run.n_rigid, 1].mean(axis=1)
        still, mean_force, velocity = (
            errors_of(found, name)[number]
            for name in ('persistence', 'mean force', 'constant velocity')
        )
        for row, held in ((still, run.force[H - 1]), (mean_force, mean)):
            error = held - truth
            share = np.linalg.norm(error) / np.linalg.norm(truth)
            assert row['force_l2'] == pytest.approx(share, rel=1e-4)
            assert row['force_n'] == pytest.approx(rms(error), rel=1e-4)
            assert row['vertical_n'] == pytest.approx(rms(error[:, 1]), rel=1e-4)
        assert still['height_mm'] == pytest.approx(1e3 * rms(height[H:] - height[H - 1]), rel=1e-3)
        # The soil, over the particles that the dataset keeps.
        soil = synthetic.soil_of(folder, 'test', number)[8::4, ::3]
        modes = run.position[H - 1, run.n_rigid :].astype(float)
        space = document.soil_truth.TruthReader(folder).subspace
        held = space.decode(modes[None])[0, ::3]
        assert still['soil_mm'] == pytest.approx(1e3 * rms(soil - held), rel=1e-4)
        # Each is judged in what it says anything of.
        assert 'force_l2' not in velocity and 'soil_mm' not in mean_force
        ridge, again = (errors_of(found, name)[number] for name in ('path ridge', 'mine'))
        assert ridge['soil_mm'] == again['soil_mm'] < still['soil_mm']
        assert again['status'] and 'status' not in ridge


def test_what_is_said_of_a_run_is_that_of_its_particles(judged, tmp_path):
    folder, found = judged
    facts = found['runs']['test'][1]
    soil, rest = (synthetic.soil_of(folder, 'test', 1, size)[:, ::3] for size in (2e-3, 0.0))
    moved = soil[8::4] - soil[0]
    assert facts['motion_mm'] == pytest.approx(1e3 * rms(moved), rel=1e-4)
    assert facts['truncation_mm'] == pytest.approx(1e3 * rms((soil - rest)[8::4]), rel=1e-3)
    assert found['data']['truth'] == '17 particles in every 4. frame'
    plain = synthetic.write_dataset(tmp_path / 'data')
    with pytest.raises(FileNotFoundError, match='subspace'):
        document.facts(plain)
    synthetic.write_subspace(plain)
    path = os.path.join(plain, 'metadata.json')
    files.write_json(path, files.read_json(path) | {'projection_mse': {'test': [4e-6, 9e-6]}})
    data, runs = document.facts(plain)
    assert runs['test'][1]['truncation_mm'] == pytest.approx(3.0)
    assert 'decoded from the modes' in data['truth']


def test_a_document_holds_every_number_of_its_tables(judged, tmp_path):
    _, found = judged
    text = json.dumps(found, allow_nan=False)
    assert tables.complete(json.loads(text)) == json.loads(text)
    path = str(tmp_path / 'synthetic.json')
    files.write_json(path, found)
    marks = 'means {} test soil_mm force_l2 height_mm', 'of_method {} test mine soil_mm'
    page = '\n\n'.join(f'<!-- table: reports.protocol.tables:{m.format(path)} -->' for m in marks)
    shown = documents.render(page + '\n')
    ridge = found['summary']['test']['all']['soil_mm']['path ridge']
    assert f'*path ridge* | {ridge["mean"]["mean"]:.3g}' in shown
    with pytest.raises(ValueError, match='KeyError'):
        documents.render(f'<!-- table: reports.protocol.tables:means {path} none soil_mm -->\n')


def test_methods_of_a_dataset_are_those_shipped_for_it_and_those_trained_here():
    values = types.SimpleNamespace(model=[], train=['pcg'], work_path='work', num_seeds=2)
    found = {method.name: method for method in document.methods_of('wheel_v2', values)}
    ((shipped, flags),) = found['swept_field'].models
    assert os.path.relpath(shipped, record.ROOT) == 'models/wheel_v2/swept_field' and flags is None
    assert 'fcg_original' not in found  # that is a model of the scene's first dataset
    assert [path for path, _ in found['pcg'].models] == [
        f'work/models/wheel_v2/pcg_{i}' for i in (0, 1)
    ]
    assert [m.name for m in found.values() if m.baseline] == [
        name for name, _ in document.BASELINES.values()
    ]
    values.model = ['nameless']
    with pytest.raises(ValueError, match='NAME=FOLDER'):
        document.methods_of('wheel_v2', values)


def test_a_model_that_fails_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, 'start', lambda *_: contextlib.nullcontext(Crew()))
    monkeypatch.setattr(rollouts, 'make', lambda job: (_ for _ in ()).throw(ValueError('bad')))
    values = types.SimpleNamespace(cluster='', num_processes=1)
    methods = [document.Method('a', [('a_0', [])]), document.Method('b', [('b', [])], (), True)]
    with pytest.raises(ValueError, match='1 of 2 models failed.*\n.*a_0: bad'):
        document._make(methods, 'data', values, str(tmp_path))
    assert document._make(methods[1:], 'data', values, str(tmp_path)) == []


def test_the_version_of_data_stands_with_their_cases():
    old = {'cases': {'train': [{'case': 1}]}}
    assert document.data_version(old) == document.data_version({}) == 1
    old['cases']['test'] = [{'case': 2, 'data_version': '2'}]
    assert document.data_version(old) == 2
    shipped = files.read_json(f'{record.ROOT}/datasets/wheel_v2/metadata.json')
    stored = files.read_json(f'{record.ROOT}/docs/protocol/wheel_v2.json')
    assert stored['data']['version'] == document.data_version(shipped) == 2
