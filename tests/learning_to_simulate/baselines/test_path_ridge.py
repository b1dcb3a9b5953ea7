"""Kernel ridge on the path: its closed form, what it may not look at, and what it reaches."""

import dataclasses
import functools
import json

import numpy as np
import pytest

from learning_to_simulate import metrics, reading_utils
from learning_to_simulate.baselines import path_ridge
from learning_to_simulate.baselines.path_ridge import SETS, PathInputs, PathRidge, Regression
from pca_tools import dataset
from tests.learning_to_simulate import synthetic

H = 6


def read(folder, motion, **data):
    path = synthetic.write_dataset(folder, motion=motion, **data)
    metadata = dataset.read_metadata(path)
    groups = {n: reading_utils.read_groups(path, n, metadata) for n in ('train', 'valid', 'test')}
    return groups, reading_utils.read_scene(path, metadata, groups['train'], None)


@pytest.fixture(scope='module')
def fitted(tmp_path_factory):
    """Makes (method, scene, test runs) by motion and way of fitting, once."""

    @functools.cache
    def make(motion='prescribed', few=False, context=False):
        groups, scene = read(tmp_path_factory.mktemp('data'), motion, n_run=8, context=context)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(path_ridge, 'GAMMAS', (0.1, 1.0))
            patch.setattr(path_ridge, 'ALPHAS', (1e-6, 1e-3))
            patch.setattr(path_ridge, 'KERNELS', {'gaussian': np.inf, 'matern': 1.5})
            patch.setattr(path_ridge, 'BEST', 3)
            method = PathRidge.fit(groups['train'], groups['valid'], scene, few_runs=few)
        return method, scene, groups['test'][0]

    return make


@pytest.mark.parametrize('motion', ['prescribed', 'driven'])
def test_it_finds_what_the_path_decides(fitted, motion):
    method, scene, group = fitted(motion)
    (position, force), truth = method.predict(group), group.position[:, H:]
    still, n = path_ridge.held_position(group, scene), group.n_rigid
    ours, theirs = (metrics.soil_mse(p, truth, n, scene.n_soil).mean() for p in (position, still))
    assert ours < 0.2 * theirs
    errors = metrics.force_errors(force, group.force[:, H:])
    assert errors['force_relative_l2'].max() < 0.5
    if motion == 'driven':
        height = [np.abs((p - truth)[:, :, :n, 1]).mean() for p in (position, still)]
        assert height[0] < 0.5 * height[1]
        assert set(method.regressions) == {'soil', 'force', 'height'}
    else:
        np.testing.assert_array_equal(position[:, :, :n], truth[:, :, :n])


@pytest.mark.parametrize('motion', ['prescribed', 'driven'])
def test_it_looks_at_nothing_but_the_start_and_the_known_motion_so_far(fitted, motion):
    method, scene, group = fitted(motion)
    (expected, expected_force), n = method.predict(group), group.n_rigid
    changed, force = group.position.copy(), group.force.copy()
    changed[:, H:, n:] += 7.0
    force[:, H:] *= -3.0
    if motion == 'driven':
        changed[:, H:, :n, scene.up_axis] += 0.3
    found = method.predict(dataclasses.replace(group, position=changed, force=force))
    np.testing.assert_allclose(found[0], expected, atol=1e-9)
    np.testing.assert_allclose(found[1], expected_force, atol=1e-9)
    changed = group.position.copy()
    changed[:, 25:, :n] -= [0.01, 0.005, 0.0]
    found, _ = method.predict(dataclasses.replace(group, position=changed))
    same = slice(0, 25 - H)
    np.testing.assert_allclose(found[:, same], expected[:, same], atol=1e-12)
    assert np.abs(found - expected)[:, 25 - H :, n:].max() > 1e-3


def test_its_parts_give_the_same_method_back(fitted):
    method, scene, group = fitted('driven', few=True, context=True)
    assert {len(each) for each in method.regressions.values()} == {6}
    values, arrays = method.parts()
    again = PathRidge.of_parts(json.loads(json.dumps(values)), arrays, scene)
    for one, other in zip(method.predict(group), again.predict(group)):
        np.testing.assert_array_equal(one, other)
    assert again.choices == method.choices
    assert len(method.choices) == 4 * 4 * 2  # targets, widths and ridges, kernels


def test_the_force_is_the_mean_of_its_regressions(fitted):
    method, scene, group = fitted('driven', few=True)
    each = [one for one in method.regressions['force']]
    free = dataclasses.replace(each[0], offset=np.zeros(3))
    method = PathRidge(scene, method.reader, method.regressions | {'force': [*each, free]})
    forces = []
    for regression in (*each, free):
        one = PathRidge(scene, method.reader, method.regressions | {'force': [regression]})
        forces.append(one.predict(group)[1])
        pushed = dataclasses.replace(group, force=group.force + [5.0, 0.0, 0.0])
        # What is regressed is the change since the last given frame, or the force itself.
        change = [5.0 * (regression.offset is None), 0.0, 0.0]
        np.testing.assert_allclose(one.predict(pushed)[1], forces[-1] + change, atol=1e-9)
    np.testing.assert_allclose(method.predict(group)[1], np.mean(forces, axis=0), rtol=1e-12)


@pytest.mark.parametrize('few', [False, True], ids=['valid runs', 'runs left out'])
def test_the_best_are_chosen(fitted, few):
    method, _, group = fitted('prescribed', few)
    n_frame = group.position.shape[1] - H + 1
    # Fitted to train, or to train and valid.
    assert len(method.regressions['soil'][0].samples) / n_frame == (10 if few else 8)
    for output, regressions in method.regressions.items():
        for kernel in {one.kernel for one in regressions}:
            tried = [c for c in method.choices if (c['output'], c['kernel']) == (output, kernel)]
            best = sorted(tried, key=lambda c: c['error'])[: 3 if few else 1]
            found = [one for one in regressions if one.kernel == kernel]
            for one, choice in zip(found, best, strict=True):
                assert (one.inputs, one.alpha) == (choice['inputs'], choice['alpha'])
                assert (one.offset is not None) == (choice['target'] == 'free force')


@pytest.mark.parametrize('most', [10_000, 40])
def test_each_sample_knows_its_run(tmp_path, most):
    found, scene = read(tmp_path, 'prescribed', n_run=3)
    groups = found['train'] + found['valid']
    samples = path_ridge._Samples(groups, PathInputs.of(groups, scene), most)
    forces = [force[H - 1 :] for group in groups for force in group.force]
    y = samples.y[:, samples.columns['free force']] + samples.offsets['free force']
    assert sorted(set(samples.run)) == list(range(len(forces)))
    for run, value in zip(samples.run, y, strict=True):
        assert np.abs(forces[run] - value).max(axis=1).min() < 1e-9


def test_a_body_of_unknown_motion_is_refused(tmp_path):
    groups, scene = read(tmp_path, 'predicted')
    with pytest.raises(ValueError, match='motion is given'):
        PathRidge.fit(groups['train'], groups['valid'], scene)


@pytest.mark.parametrize(
    ('name', 'kernel'),
    [
        ('gaussian', lambda d: np.exp(-(d**2) / 2)),
        ('matern', lambda d: (1 + 3**0.5 * d) * np.exp(-(3**0.5) * d)),
        ('exponential', lambda d: np.exp(-d)),
    ],
)
def test_a_regression_is_the_closed_form(name, kernel):
    """dual = (K + alpha I)^-1 y on inputs of mean 0 and deviation 1."""
    rng = np.random.default_rng(0)
    x, y = rng.normal(3.0, [1.0, 50.0, 0.0], (40, 3)), rng.normal(size=(40, 2))
    regression = Regression.fit('path', x, y, 0.6, [1.0, 0.03], name)[1]
    scale = np.where(x.std(axis=0) > 1e-9, x.std(axis=0), 1.0)
    scaled = (x - x.mean(axis=0)) / scale

    def gram(a, b):  # gamma is 0.6 / 3 inputs; the length of it sqrt(1 / (2 gamma))
        distance = np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=-1))
        return kernel(distance * np.sqrt(2 * 0.2))

    dual = np.linalg.solve(gram(scaled, scaled) + 0.03 * np.eye(40), y)
    np.testing.assert_allclose(regression.dual, dual, rtol=1e-8, atol=1e-10)
    new = rng.normal(3.0, [1.0, 50.0, 0.0], (2, 5, 3))
    at = ((new - x.mean(axis=0)) / scale).reshape(10, 3)
    expected = gram(at, scaled) @ dual
    np.testing.assert_allclose(regression(new).reshape(10, 2), expected, rtol=1e-8, atol=1e-9)


def test_arrays_that_do_not_fit_each_other_are_refused():
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(9, 3)), rng.normal(size=(9, 2))
    (fitted,) = Regression.fit('path', x, y, 1.0, [0.1], 'gaussian')
    wrong = {'dual': fitted.dual[1:], 'shift': fitted.shift[1:], 'scale': np.zeros(3),
             'offset': np.zeros(3), 'kernel': 'box'}  # fmt: skip
    for name, value in wrong.items():
        with pytest.raises(ValueError, match='do not fit'):
            dataclasses.replace(fitted, **{name: value})


@pytest.mark.parametrize('name', SETS)
def test_only_inputs_of_the_bed_know_where_a_run_began(fitted, name):
    method, _, group = fitted()
    reader = method.reader
    way = np.eye(3)[reader.axes.axis] * 0.03
    shifted = dataclasses.replace(group, position=group.position + way)
    here, there = reader.read(group, name), reader.read(shifted, name)
    assert here.shape == there.shape
    if name == 'bed':
        begun = there[..., -1] - here[..., -1]
        np.testing.assert_allclose(begun, reader.axes.sign * 0.03, rtol=1e-5)
        assert np.abs(there[..., :-1] - here[..., :-1]).max() > 1e-3
    else:
        np.testing.assert_allclose(there, here, atol=1e-6)
