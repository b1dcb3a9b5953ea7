"""Kernel ridge on the path: its closed form, what it may not look at, and what it reaches."""

import dataclasses
import json

import numpy as np
import pytest
from sklearn.gaussian_process.kernels import RBF, Matern
from sklearn.kernel_ridge import KernelRidge
from sklearn.model_selection import LeaveOneGroupOut, cross_val_predict

from learning_to_simulate import metrics, reading_utils
from learning_to_simulate.baselines import open_loop, path_ridge
from learning_to_simulate.baselines.path_ridge import (
    SETS,
    PathInputs,
    PathRidge,
    Regression,
    errors_left_out,
    gram_matrix,
)
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


def test_errors_on_runs_left_out_are_those_of_fits_without_them():
    """scikit-learn leaves each run out and fits again; the scaling is that of all samples."""
    rng = np.random.default_rng(1)
    x, run = rng.normal(2.0, [1.0, 30.0], (45, 2)), np.repeat([0, 1, 2, 5], [10, 15, 12, 8])
    y = np.stack([np.sin(x[:, 0]), np.cos(x[:, 1] / 30) + x[:, 0]], axis=1)
    alphas = [1e-6, 1e-3, 1.0]
    found = errors_left_out(x, y, run, 0.7, alphas)
    scaled = (x - x.mean(axis=0)) / x.std(axis=0)
    for alpha, errors in zip(alphas, found, strict=True):
        ridge = KernelRidge(alpha=alpha, kernel='rbf', gamma=0.35)
        predicted = cross_val_predict(ridge, scaled, y, groups=run, cv=LeaveOneGroupOut())
        np.testing.assert_allclose(
            errors, y - predicted, rtol=1e-5, atol=1e-6 * np.abs(errors).max()
        )


@pytest.mark.parametrize(
    ('name', 'theirs'),
    [
        ('gaussian', RBF),
        ('matern', lambda length: Matern(length, nu=1.5)),
        ('exponential', lambda length: Matern(length, nu=0.5)),
    ],
)
def test_kernels_are_those_of_scikit_learn(name, theirs):
    rng = np.random.default_rng(3)
    a, b, gamma = rng.normal(size=(7, 3)), rng.normal(size=(5, 3)), 0.3
    expected = theirs(1 / np.sqrt(2 * gamma))(a, b)
    np.testing.assert_allclose(gram_matrix(a, b, gamma, name), expected, rtol=1e-12)


def test_arrays_that_do_not_fit_each_other_are_refused():
    rng = np.random.default_rng(2)
    (fitted,) = Regression.fit('path', rng.normal(size=(9, 3)), rng.normal(size=(9, 2)), 1.0, [0.1])
    fitted.check()
    wrong = {'dual': fitted.dual[1:], 'shift': fitted.shift[1:], 'scale': np.zeros(3),
             'offset': np.zeros(3), 'kernel': 'box'}  # fmt: skip
    for name, value in wrong.items():
        broken = Regression(**(vars(fitted) | {name: value}))
        with pytest.raises(ValueError, match='do not fit'):
            broken.check()


@pytest.fixture(scope='module')
def read(tmp_path_factory):
    """(reader, a group of runs) of a blade."""
    path = synthetic.write_dataset(tmp_path_factory.mktemp('data'), motion='prescribed')
    metadata = dataset.read_metadata(path)
    groups = reading_utils.read_groups(path, 'train', metadata)
    scene = reading_utils.read_scene(path, metadata, groups, None)
    return PathInputs.of(groups, scene), groups[0]


@pytest.mark.parametrize('name', SETS)
def test_only_inputs_of_the_bed_know_where_a_run_began(read, name):
    reader, group = read
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


def test_a_reader_is_restored_from_its_description(read):
    reader, group = read
    again = PathInputs.from_json(reader.to_json(), reader.scene)
    for name in SETS:
        np.testing.assert_array_equal(again.read(group, name), reader.read(group, name))
