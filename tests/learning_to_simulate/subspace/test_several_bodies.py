"""Two bodies of given motion in one scene: a force on each; what knows one body refuses them."""

import dataclasses
import os

import numpy as np
import pytest

from learning_to_simulate import evaluation, rollout
from learning_to_simulate.native import model_data
from learning_to_simulate.presets import make_config
from learning_to_simulate.rollout_status import OK
from learning_to_simulate.scene import Scene
from pca_tools import dataset, files
from tests.learning_to_simulate import models, synthetic
from tests.learning_to_simulate.twins.numpy_twin import Twin, WholeStateTwin

H = 6
POINTS = {'blade': 4, 'wheel': 3}


def write(folder, motions=('prescribed', 'prescribed'), each=True):
    """A dataset of a blade and a wheel; `each`: whether the force on each is known."""
    folder = synthetic.write_dataset(folder, rigid_counts=(7,))
    path = os.path.join(folder, 'metadata.json')
    metadata = files.read_json(path)
    metadata['scene']['bodies'] = [
        {'name': name, 'rigid_motion': motion, 'points': count}
        for (name, count), motion in zip(POINTS.items(), motions, strict=True)
    ]
    files.write_json(path, metadata)
    for split in dataset.SPLITS:
        runs = []
        for run in dataset.read_split(folder, split):
            share = 0.7 + 0.1 * np.sin(np.arange(run.n_frames))[:, None]
            forces = np.stack([share * run.force, (1 - share) * run.force], axis=1)
            body_force = forces.astype(np.float32) if each else None
            runs.append(dataclasses.replace(run, body_force=body_force))
        dataset.write_split(dataset.split_path(folder, split), runs)
    return folder


def make(folder, preset='pcg', **overrides):
    config = make_config(preset, **models.SMALL | overrides)
    model, (group,), _ = models.of_dataset(folder, config)
    return model, group


@pytest.fixture(scope='module')
def data(tmp_path_factory):
    """Not to be changed."""
    return write(str(tmp_path_factory.mktemp('data')))


@pytest.fixture(scope='module')
def made(data):
    return make(data)


def test_the_scene_knows_its_bodies_and_the_force_on_each(made):
    model, group = made
    scene = model.simulator.scene
    assert scene.bodies == tuple(POINTS.items()) and group.force.shape[-1] == 6
    assert Scene.from_json(scene.to_json()) == scene
    total = evaluation.total_force(group.force[0])
    expected = synthetic.make_trajectory(0, 7).force
    np.testing.assert_allclose(total, expected, rtol=1e-5, atol=1e-5)
    r = scene.n_modes
    expected = [0] * 4 + [r + 1] * 3 + list(range(1, r + 1))
    np.testing.assert_array_equal(model.layout(7).embedded, expected)


def test_thinning_keeps_the_lowest_of_each_body(data):
    model, group = make(data, rigid_particles=2)
    assert model.simulator.scene.bodies == (('blade', 2), ('wheel', 2)) and group.n_rigid == 4
    run = dataset.read_split(data, 'train')[0]
    for body, kept in ((range(4), group.kept[0][:2]), (range(4, 7), group.kept[0][2:])):
        lowest = sorted(body, key=lambda i: run.position[0, i, 1])[:2]
        assert sorted(lowest) == kept.tolist()


@pytest.mark.parametrize('preset', ['pcg', 'pcg_thesis', 'mlp'])
def test_a_step_is_that_of_the_numpy_twin(data, preset):
    own = {'mode_edges': 0} if preset == 'mlp' else {}
    model, group = make(data, preset, rigid_particles=0, **own)
    (position,), (force,) = models.steps(model, group)
    twin = WholeStateTwin if preset == 'mlp' else Twin
    expected, expected_force = twin(model, 7).step(
        group.position[0, :H], group.position[0, H, :7], None
    )
    np.testing.assert_allclose(position, expected, atol=1e-5)
    assert force.shape == (6,)
    np.testing.assert_allclose(force, expected_force, atol=1e-4 * np.abs(expected_force).max())


def test_files_and_errors_are_of_the_force_on_each(made, tmp_path):
    """Half a newton too much on the one and too little on the other: the total is right."""
    model, group = made
    off = np.repeat([[0.5, -0.5]], 3, axis=1)
    result = rollout.Rollout(
        group.position[:1, H:], (group.force[:1, H:] + off).astype(np.float32),
        [OK], 1.0,
    )  # fmt: skip
    results = [(0, group.select(0), result)]
    summary = evaluation.summarise(results, model, {}, 'test')
    assert summary['mean']['model']['force_rmse'] == pytest.approx(0.5, rel=1e-5)
    arrays = files.read_npz(evaluation.save_rollouts(str(tmp_path), 'test', results, {}, {})[0])
    each, total = arrays['predicted_body_forces'], arrays['predicted_forces']
    assert each.shape == (len(total), 2, 3)
    np.testing.assert_allclose(each.sum(axis=1), total, atol=1e-4)
    np.testing.assert_allclose(arrays['ground_truth_forces'], total, atol=1e-4)


def test_live_steps_by_particles_give_the_force_on_each(made):
    model, group = made
    stepper = models.stepper(model, 7)
    assert stepper.reset(group.position[0, :H]).status == 'ok'
    frame = stepper.step(group.position[0, H, :7])
    assert frame.force.shape == (2, 3) and np.isfinite(frame.force).all()


def test_a_total_alone_is_one_force(tmp_path):
    model, group = make(write(str(tmp_path), each=False))
    assert group.force.shape[-1] == 3 and model.simulator.force_size == 3
    assert len(model.simulator.scene.bodies) == 2


@pytest.mark.parametrize('motions', [('prescribed', 'driven'), ('predicted', 'predicted')])
def test_bodies_that_move_by_themselves_are_refused_before_any_work(tmp_path, motions):
    with pytest.raises(ValueError, match="several bodies .'blade', 'wheel'.*State the recorded"):
        make(write(str(tmp_path), motions))


def test_what_knows_one_body_says_so(made):
    model, _ = made
    for message, call in (
        ('the C form knows one', lambda: model_data.values(model, 7)),
        ('7 nodes, not 6', lambda: model.layout(6)),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_damaged_numbers_of_bodies_are_refused(made):
    scene, statistics = made[0].simulator.scene, made[0].simulator.statistics
    scene.check()
    statistics.check(scene)
    with pytest.raises(ValueError, match='body'):
        dataclasses.replace(scene, bodies=(('blade', -1),)).check()
    wrong = dataclasses.replace(statistics, force_mean=np.zeros(5), force_std=np.ones(5))
    with pytest.raises(ValueError, match='force_mean'):
        wrong.check(scene)
