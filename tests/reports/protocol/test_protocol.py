"""Truth, errors of runs, rollout files and tables of the protocol, on a small dataset."""

import json
import os
import types

import numpy as np
import pytest

from pca_tools import files
from reports import documents, record
from reports.protocol import baselines, document, rollouts, run_errors, tables
from reports.protocol.truth import TruthReader
from tests.learning_to_simulate import synthetic

H, FRAMES, N_SOIL, STRIDE = 6, synthetic.N_FRAMES, synthetic.N_SOIL, 4


def make(tmp_path):
    """A dataset with a subspace and, as yet, no particles."""
    path = synthetic.write_dataset(tmp_path / 'data', n_run=4)
    synthetic.write_subspace(path)
    return path


@pytest.fixture
def folder(tmp_path):
    return make(tmp_path)


def test_motion_and_truncation_are_those_of_the_particles(folder):
    path = os.path.join(folder, 'metadata.json')
    files.write_json(path, files.read_json(path) | {'projection_mse': {'test': [4e-6, 9e-6]}})
    assert list(TruthReader(folder).runs('test'))[1].truncation == pytest.approx(3.0)
    chosen = synthetic.write_particles(folder)
    truth = list(TruthReader(folder).runs('test'))[1]
    soil = synthetic.soil_of(folder, 'test', 1)
    moved = soil[8::STRIDE, chosen] - soil[0, chosen]
    assert truth.motion == pytest.approx(1e3 * np.sqrt((moved**2).mean()), rel=1e-4)
    exact = run_errors.RunPrediction(modes=truth.modes)
    found = run_errors.run_errors(exact, truth)
    assert found['soil_mm'] == pytest.approx(truth.truncation) and truth.truncation > 1.0


def test_force_height_and_torque_are_judged_where_both_sides_have_them(folder):
    reader = TruthReader(folder)
    truth = next(reader.runs('test'))
    count = len(truth.force)
    full = truth.__class__(
        **{**vars(truth), 'height': np.zeros(count), 'torque': np.ones((count, 3))}
    )
    assert full.axes == (0, 1, 2)  # it travels along x, and y is up
    torque = np.zeros((count, 3))
    torque[:, 2] = 0.75
    prediction = run_errors.RunPrediction(
        force=1.5 * truth.force, height=np.full(count, 2e-3), torque=torque
    )
    found = run_errors.run_errors(prediction, full)
    assert found['force_l2'] == pytest.approx(0.5)
    assert found['force_n'] == pytest.approx(0.5 * np.sqrt((truth.force**2).mean()))
    assert found['height_mm'] == pytest.approx(2.0) and found['pitch_l2'] == pytest.approx(0.25)
    assert found['torque_l2'] == pytest.approx(np.sqrt((1 + 1 + 0.25**2) / 3))
    found = run_errors.run_errors(prediction, truth)
    assert {name.partition('_')[0] for name in found} == {'force', 'drawbar', 'vertical'}


def write_rollout(path, truth, **more):
    """A rollout file with R = 2 rigid nodes and the true modes plus 1 mm."""
    body = np.zeros((len(truth.modes), 2, 3)) + [0.0, 0.4, 0.0]
    nodes = np.concatenate([body, truth.modes + 1e-3], axis=1).astype(np.float32)
    files.write_npz(
        str(path),
        predicted_rollout=nodes,
        particle_types=np.array([3, 3] + [6] * truth.modes.shape[1]),
        status=np.array('ok'),
        **more,
    )


def test_rollout_files_of_modes_and_of_particles(folder, tmp_path):
    synthetic.write_particles(folder)
    reader = TruthReader(folder)
    truths = list(reader.runs('test'))
    force = truths[0].force.astype(np.float32)
    write_rollout(tmp_path / 'rollout_test_0.npz', truths[0], predicted_forces=force)
    frames = np.arange(H, FRAMES)
    soil = synthetic.soil_of(folder, 'test', 1)
    write_rollout(
        tmp_path / 'rollout_test_1.npz',
        truths[1],
        predicted_particles=soil[frames],
        particle_frames=frames,
        particle_indices=np.arange(N_SOIL),
    )
    modes, field = rollouts.read(str(tmp_path), 'test', 2, reader.metadata)
    np.testing.assert_allclose(modes.modes, truths[0].modes + 1e-3, atol=1e-5)
    assert modes.status == 'ok' and modes.height == pytest.approx(0.4)
    errors = run_errors.run_errors(modes, truths[0])
    assert errors['force_l2'] < 1e-6 and errors['soil_mm'] > 0
    assert run_errors.run_errors(field, truths[1])['soil_mm'] < 1e-3
    with pytest.raises(ValueError, match='soil nodes'):
        rollouts.read(str(tmp_path), 'test', 1, reader.metadata | {'mode_number': 9})
    with pytest.raises(FileNotFoundError):
        rollouts.read(str(tmp_path), 'test', 3, reader.metadata)


@pytest.fixture(scope='module')
def judged(tmp_path_factory):
    """A whole document of the small dataset: baselines and a 'model' of two seeds."""
    tmp_path = tmp_path_factory.mktemp('judged')
    folder = make(tmp_path)
    synthetic.write_particles(folder)
    reader = TruthReader(folder)
    methods = [
        {
            'name': b.name,
            'baseline': True,
            'about': b.about,
            'seeds': [
                {
                    'seed': None,
                    'source': 'here',
                    'predictions': {
                        s: baselines.predictions(b, reader, s) for s in document.SPLITS
                    },
                }
            ],
        }
        for b in baselines.fit_all(reader)
    ]
    for seed in range(2):
        for split in document.SPLITS:
            (tmp_path / f'{seed}{split}').mkdir()
            for truth in reader.runs(split):
                name = f'rollout_{split}_{truth.record}.npz'
                write_rollout(tmp_path / f'{seed}{split}' / name, truth)
    methods.append(
        {
            'name': 'model',
            'baseline': False,
            'about': {},
            'seeds': [
                {
                    'seed': i,
                    'source': 'files',
                    'predictions': {
                        s: rollouts.read(str(tmp_path / f'{i}{s}'), s, 2, reader.metadata)
                        for s in document.SPLITS
                    },
                }
                for i in range(2)
            ],
        }
    )
    head = {'schema_version': 1, 'scene': 'synthetic'}
    return tables.complete(head | document.judge(reader, methods))


def test_a_document_holds_every_number_of_its_tables(judged, tmp_path):
    names = [m['name'] for m in judged['methods']]
    assert names == ['persistence', 'constant velocity', 'mean force', 'path ridge', 'model']
    text = json.dumps(judged, allow_nan=False)
    summary = judged['summary']['test']['all']
    assert set(summary) == {'soil_mm', 'force_l2', 'drawbar_l2'}
    assert 'model' not in summary['force_l2'] and 'mean force' not in summary['soil_mm']
    ridge = summary['soil_mm']['path ridge']
    assert ridge['mean']['mean'] < summary['soil_mm']['persistence']['mean']['mean']
    rms = [run['soil_mm'] for run in judged['methods'][0]['seeds'][0]['runs']['test']]
    moving = [r for r, run in zip(rms, judged['runs']['test']) if run['motion_mm'] >= 1]
    assert summary['soil_mm']['persistence']['mean']['mean'] == pytest.approx(np.mean(moving))
    assert tables.complete(json.loads(text)) == json.loads(text)

    path = str(tmp_path / 'synthetic.json')
    files.write_json(path, judged)
    marks = 'means {} test soil_mm force_l2', 'of_method {} test model soil_mm'
    page = '\n\n'.join(f'<!-- table: reports.protocol.tables:{m.format(path)} -->' for m in marks)
    shown = documents.render(page + '\n')
    assert 'model (2 seeds)' in shown and '*path ridge*' in shown
    assert f'{ridge["mean"]["mean"]:.3g}' in shown
    table = tables.quantity_table(judged, 'test', 'soil_mm')
    assert f'{ridge["mean"]["mean"]:.3g}' in table and 'model (2 seeds)' in table
    with pytest.raises(ValueError, match='KeyError'):
        documents.render(f'<!-- table: reports.protocol.tables:means {path} none soil_mm -->\n')


def test_errors_by_kind_are_means_over_the_runs_of_a_kind(judged):
    runs = [run | {'kind': kind} for run, kind in zip(judged['runs']['test'], ('grid', 'lift'))]
    split = tables.complete(judged | {'runs': judged['runs'] | {'test': runs}})
    lines = tables.kind_table(split, 'test', 'force_l2').splitlines()
    assert lines[0] == '| method | grid (1) | lift (1) | all (2) |'
    row = next(line for line in lines if line.startswith('| *path ridge*')).split(' | ')[1:]
    errors = [
        run['force_l2'] for m in judged['methods'] if m['name'] == 'path ridge'
        for run in m['seeds'][0]['runs']['test']
    ]  # fmt: skip
    shown = [float(cell.strip(' |')) for cell in row]
    assert shown == pytest.approx([*errors, np.mean(errors)], rel=5e-3)
    # One kind alone: all runs.
    assert tables.kind_table(judged, 'test', 'force_l2').startswith('| method | all (2) |')


def test_input_that_cannot_be_judged_is_refused(tmp_path):
    path = synthetic.write_dataset(tmp_path / 'data')
    with pytest.raises(FileNotFoundError, match='subspace'):
        TruthReader(path)
    values = types.SimpleNamespace(model=['nameless'], train=[], work_path='x', num_seeds=1)
    with pytest.raises(ValueError, match='NAME=FOLDER'):
        document._models_of('wheel', values)


def test_methods_of_a_dataset_are_those_shipped_for_it_and_those_trained_here():
    values = types.SimpleNamespace(
        model=[], train=['mlp --modes=8', 'pcg'], work_path='work', num_seeds=2
    )
    found = document._models_of('wheel_v2', values)
    assert [os.path.relpath(p, record.ROOT) for p in found['swept_field']] == [
        'models/wheel_v2/swept_field'
    ]
    assert 'fcg_original' not in found  # that is a model of the scene's first dataset
    assert found['mlp --modes=8'] == [f'work/models/wheel_v2/mlp_modes_8_{i}' for i in (0, 1)]
    assert rollouts.training_flags('mlp --modes=8') == ['--preset=mlp', '--modes=8']
    # Only those of --train are trained, and have flags: other names may be any text.
    jobs = document._jobs({'field, one member': ['a'], 'pcg': ['b', 'c']}, 'data', values, 'out')
    assert [job[2] for job in jobs] == [
        None, *(['--preset=pcg', f'--seed={seed}', '--num_threads=1'] for seed in (0, 1))
    ]  # fmt: skip
    values.train = ['pcg --adjacency=lists/{seed}.json']
    (first, second) = document._jobs({values.train[0]: ['a', 'b']}, 'data', values, 'out')
    assert first[2][1] == '--adjacency=lists/0.json' and second[2][2] == '--seed=1'
    # A regression draws nothing: it is trained once, and is given no seed, which it would refuse.
    values.train = ['path_ridge']
    found = document._models_of('mine', values)
    assert found == {'path_ridge': ['work/models/mine/path_ridge_0']}
    assert document._jobs(found, 'data', values, 'out')[0][2] == [
        '--preset=path_ridge', '--num_threads=1'
    ]  # fmt: skip
    for bad in ('', 'mlp modes=8', '--modes=8'):
        with pytest.raises(ValueError, match='--FLAG=VALUE'):
            rollouts.training_flags(bad)
