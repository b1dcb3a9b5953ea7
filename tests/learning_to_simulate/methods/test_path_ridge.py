"""Kernel ridge on the path: its closed form, what it may not look at, and what it reaches."""

import dataclasses
import json

import numpy as np
import pytest

from learning_to_simulate import metrics, reading_utils
from learning_to_simulate.methods import open_loop, path_ridge
from learning_to_simulate.methods.path_inputs import PathInputs
from learning_to_simulate.methods.path_ridge import PathRidge
from pca_tools import dataset
from tests.learning_to_simulate import synthetic

H = 6
FEW_RUNS = {'leave_one_out': True, 'kernels': ('gaussian', 'matern'), 'n_best': 3}
FEW = {'gammas': (0.1, 1.0), 'alphas': (1e-6, 1e-3)}


def fitted(folder, motion='prescribed', options=None, **data):
    """A method fitted to a synthetic dataset, its scene and test runs."""
    path = synthetic.write_dataset(folder, motion=motion, n_run=8, **data)
    metadata = dataset.read_metadata(path)
    groups = {n: reading_utils.read_groups(path, n, metadata) for n in ('train', 'valid', 'test')}
    scene = reading_utils.read_scene(path, metadata, groups['train'], None)
    method = PathRidge.fit(groups['train'], groups['valid'], scene, **FEW, **(options or {}))
    return method, scene, groups['test'][0]


@pytest.mark.parametrize('motion', ['prescribed', 'driven'])
def test_it_finds_what_the_path_decides(tmp_path, motion):
    method, scene, group = fitted(tmp_path, motion)
    prediction = method.predict(group)
    truth = group.position[:, H:]
    still = open_loop.persistence(group, scene).position
    ours, theirs = (
        metrics.soil_mse(p, truth, group.n_rigid, scene.n_soil).mean()
        for p in (prediction.position, still)
    )
    assert ours < 0.2 * theirs
    assert (
        metrics.force_errors(prediction.force, group.force[:, H:])['force_relative_l2'].max() < 0.5
    )
    if motion == 'driven':
        rigid = slice(group.n_rigid)
        height = [np.abs((p - truth)[:, :, rigid, 1]).mean() for p in (prediction.position, still)]
        assert height[0] < 0.5 * height[1]
        assert prediction.predicts == {'soil', 'force', 'height'}
    else:
        np.testing.assert_array_equal(
            prediction.position[:, :, : group.n_rigid], truth[:, :, : group.n_rigid]
        )


@pytest.mark.parametrize('motion', ['prescribed', 'driven'])
def test_it_looks_at_nothing_but_the_start_and_the_known_motion(tmp_path, motion):
    method, scene, group = fitted(tmp_path, motion)
    expected = method.predict(group)
    changed, force = group.position.copy(), group.force.copy()
    changed[:, H:, group.n_rigid :] += 7.0
    force[:, H:] *= -3.0
    if motion == 'driven':
        changed[:, H:, : group.n_rigid, scene.up_axis] += 0.3
    found = method.predict(dataclasses.replace(group, position=changed, force=force))
    np.testing.assert_allclose(found.position, expected.position, atol=1e-9)
    np.testing.assert_allclose(found.force, expected.force, atol=1e-9)


def test_the_coming_path_changes_nothing_before_it(tmp_path):
    method, _, group = fitted(tmp_path)
    changed = group.position.copy()
    changed[:, 25:, : group.n_rigid] -= [0.01, 0.005, 0.0]
    found = method.predict(dataclasses.replace(group, position=changed))
    expected = method.predict(group)
    same = slice(0, 25 - H)
    np.testing.assert_allclose(found.position[:, same], expected.position[:, same], atol=1e-12)
    assert np.abs(found.position - expected.position)[:, 25 - H :, group.n_rigid :].max() > 1e-3


@pytest.mark.parametrize(('options', 'n_best'), [(None, 1), (FEW_RUNS, 6)])
def test_a_file_gives_the_same_method_back_and_a_damaged_one_is_refused(tmp_path, options, n_best):
    method, _, group = fitted(tmp_path / 'data', 'driven', options, context=True)
    assert {len(each) for each in method.regressions.values()} == {n_best}
    path = str(tmp_path / 'path_ridge.npz')
    method.save(path)
    again = PathRidge.load(path)
    for one, other in zip(method.predict(group)[:2], again.predict(group)[:2]):
        np.testing.assert_array_equal(one, other)
    assert again.choices == method.choices
    assert len(method.choices) == 4 * 4 * (2 if options else 1)  # targets, widths and ridges
    arrays = dict(np.load(path))
    about = json.loads(str(arrays['about']))
    about['outputs']['soil'] = []
    no_soil = {'about': np.array(json.dumps(about))}
    for damage in ({'soil/0/scale': arrays['soil/0/scale'][:-1]}, no_soil):
        np.savez(path, **arrays | damage)
        with pytest.raises(ValueError, match='is not a path_ridge model'):
            PathRidge.load(path)


def test_a_file_from_before_there_could_be_several_is_read(tmp_path):
    method, _, group = fitted(tmp_path / 'data')
    path = str(tmp_path / 'path_ridge.npz')
    method.save(path)
    arrays = {key.replace('/0/', '/'): value for key, value in np.load(path).items()}
    about = json.loads(str(arrays['about']))
    for name, (values,) in about['outputs'].items():
        del values['kernel']
        about['outputs'][name] = values
    np.savez(path, **arrays | {'about': np.array(json.dumps(about))})
    for one, other in zip(method.predict(group)[:2], PathRidge.load(path).predict(group)[:2]):
        np.testing.assert_array_equal(one, other)


def test_the_force_is_the_mean_of_its_regressions(tmp_path):
    method, _, group = fitted(tmp_path, 'driven', FEW_RUNS | {'n_best': 24})
    each = method.regressions['force']
    assert {regression.offset is None for regression in each} == {True, False}
    single = [
        PathRidge(method.scene, method.reader, method.regressions | {'force': [one]})
        for one in each
    ]
    forces = [one.predict(group).force for one in single]
    pushed = dataclasses.replace(group, force=group.force + [5.0, 0.0, 0.0])
    for regression, one, force in zip(each, single, forces, strict=True):
        # What is regressed is the change since the last given frame, or the force itself.
        change = [5.0, 0.0, 0.0] if regression.offset is None else [0.0, 0.0, 0.0]
        np.testing.assert_allclose(one.predict(pushed).force, force + change, atol=1e-9)
    np.testing.assert_allclose(method.predict(group).force, np.mean(forces, axis=0), rtol=1e-12)


def test_the_valid_runs_choose(tmp_path):
    method, _, _ = fitted(tmp_path)
    for output, (regression,) in method.regressions.items():
        tried = [c for c in method.choices if c['output'] == output]
        best = min(tried, key=lambda c: c['error'])
        assert (regression.inputs, regression.alpha) == (best['inputs'], best['alpha'])
        assert (regression.offset is not None) == (best['target'] == 'free force')


def test_left_out_runs_choose_and_all_runs_are_fitted(tmp_path):
    by_valid, _, group = fitted(tmp_path / 'a')
    left_out, scene, _ = fitted(tmp_path / 'b', options=FEW_RUNS)
    n_frame = group.position.shape[1] - H + 1
    n_run = [len(m.regressions['soil'][0].samples) / n_frame for m in (by_valid, left_out)]
    assert n_run == [8, 10]  # train; train and valid
    for output, regressions in left_out.regressions.items():
        for kernel in ('gaussian', 'matern'):
            tried = [c for c in left_out.choices if (c['output'], c['kernel']) == (output, kernel)]
            best = sorted(tried, key=lambda c: c['error'])[:3]
            found = [r for r in regressions if r.kernel == kernel]
            for regression, choice in zip(found, best, strict=True):
                assert (regression.inputs, regression.alpha) == (choice['inputs'], choice['alpha'])
    truth = group.position[:, H:]
    found, still = (
        metrics.soil_mse(p.position, truth, group.n_rigid, scene.n_soil).mean()
        for p in (left_out.predict(group), open_loop.persistence(group, scene))
    )
    assert found < 0.2 * still


@pytest.mark.parametrize('most', [10_000, 40])
def test_each_sample_knows_its_run(tmp_path, most):
    path = synthetic.write_dataset(tmp_path, n_run=3)
    metadata = dataset.read_metadata(path)
    groups = reading_utils.read_groups(path, 'train', metadata)
    groups += reading_utils.read_groups(path, 'valid', metadata)
    scene = reading_utils.read_scene(path, metadata, groups, None)
    samples = path_ridge._Samples(groups, scene, PathInputs.of(groups, scene), most)
    forces = [force[H - 1 :] for group in groups for force in group.force]
    y = samples.y[:, samples.columns['free force']] + samples.offsets['free force']
    assert sorted(set(samples.run)) == list(range(len(forces)))
    for run, value in zip(samples.run, y, strict=True):
        assert np.abs(forces[run] - value).max(axis=1).min() < 1e-9


def test_a_body_of_unknown_motion_is_refused(tmp_path):
    path = synthetic.write_dataset(tmp_path, motion='driven')
    metadata = dataset.read_metadata(path)
    groups = reading_utils.read_groups(path, 'train', metadata)
    scene = reading_utils.read_scene(path, metadata, groups, 'predicted')
    with pytest.raises(ValueError, match='motion is given'):
        PathRidge.fit(groups, groups, scene)
