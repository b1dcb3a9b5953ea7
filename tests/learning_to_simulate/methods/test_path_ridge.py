"""Kernel ridge on the path: its closed form, what it may not look at, and what it reaches."""

import dataclasses

import numpy as np
import pytest

from learning_to_simulate import metrics, reading_utils
from learning_to_simulate.methods import open_loop
from learning_to_simulate.methods.path_ridge import PathRidge, Regression
from pca_tools import dataset
from tests.learning_to_simulate import synthetic

H = 6
FEW = {'gammas': (0.1, 1.0), 'alphas': (1e-6, 1e-3)}


def fitted(folder, motion='prescribed', **data):
    """A method fitted to a synthetic dataset, its scene and test runs."""
    path = synthetic.write_dataset(folder, motion=motion, n_run=8, **data)
    metadata = dataset.read_metadata(path)
    groups = {n: reading_utils.read_groups(path, n, metadata) for n in ('train', 'valid', 'test')}
    scene = reading_utils.read_scene(path, metadata, groups['train'], None)
    return PathRidge.fit(groups['train'], groups['valid'], scene, **FEW), scene, groups['test'][0]


def test_a_regression_is_the_closed_form():
    """dual = (K + alpha I)^-1 y on inputs of mean 0 and deviation 1."""
    rng = np.random.default_rng(0)
    x, y = rng.normal(3.0, [1.0, 50.0, 0.0], (40, 3)), rng.normal(size=(40, 2))
    regression = Regression.fit('path', x, y, gamma=0.6, alphas=[1.0, 0.03])[1]
    scaled = (x - x.mean(axis=0)) / np.where(x.std(axis=0) > 1e-9, x.std(axis=0), 1.0)

    def kernel(a, b):
        return np.exp(-0.2 * ((a[:, None] - b[None]) ** 2).sum(axis=-1))

    dual = np.linalg.solve(kernel(scaled, scaled) + 0.03 * np.eye(40), y)
    np.testing.assert_allclose(regression.dual, dual, rtol=1e-8, atol=1e-10)
    new = rng.normal(3.0, [1.0, 50.0, 0.0], (2, 5, 3))
    at = ((new - x.mean(axis=0)) / np.where(x.std(axis=0) > 1e-9, x.std(axis=0), 1.0)).reshape(
        10, 3
    )
    np.testing.assert_allclose(
        regression(new).reshape(10, 2), kernel(at, scaled) @ dual, rtol=1e-8, atol=1e-9
    )


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


def test_a_file_gives_the_same_method_back_and_a_damaged_one_is_refused(tmp_path):
    method, _, group = fitted(tmp_path / 'data', 'driven', context=True)
    path = str(tmp_path / 'path_ridge.npz')
    method.save(path)
    again = PathRidge.load(path)
    for one, other in zip(method.predict(group)[:2], again.predict(group)[:2]):
        np.testing.assert_array_equal(one, other)
    assert again.choices == method.choices and len(method.choices) == 4 * 4
    arrays = dict(np.load(path))
    arrays['soil/scale'] = arrays['soil/scale'][:-1]
    np.savez(path, **arrays)
    with pytest.raises(ValueError, match='is not a path_ridge model'):
        PathRidge.load(path)


def test_the_valid_runs_choose(tmp_path):
    method, _, _ = fitted(tmp_path)
    for output, regression in method.regressions.items():
        tried = [c for c in method.choices if c['output'] == output]
        best = min(tried, key=lambda c: c['valid_error'])
        assert (regression.inputs, regression.alpha) == (best['inputs'], best['alpha'])
        assert (regression.offset is not None) == (best['target'] == 'free force')


def test_a_body_of_unknown_motion_is_refused(tmp_path):
    path = synthetic.write_dataset(tmp_path, motion='driven')
    metadata = dataset.read_metadata(path)
    groups = reading_utils.read_groups(path, 'train', metadata)
    scene = reading_utils.read_scene(path, metadata, groups, 'predicted')
    with pytest.raises(ValueError, match='motion is given'):
        PathRidge.fit(groups, groups, scene)
