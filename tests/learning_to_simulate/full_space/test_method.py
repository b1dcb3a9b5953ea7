"""The full-space baseline: neighbours, invariance, data, training and rollouts in miniature."""

import dataclasses
import json

import numpy as np
import pytest
import tensorflow as tf

import learning_to_simulate as lts
from learning_to_simulate import checkpoints, presets, registry
from learning_to_simulate.full_space import method as particles
from learning_to_simulate.full_space.method import ParticleEvaluator, ParticleTrainer, read_runs
from learning_to_simulate.full_space.simulator import (
    ParticleNetwork,
    neighbour_list,
    typical_radius,
)
from learning_to_simulate.live.stepper import Stepper
from pca_tools import convert, dataset, files
from tests.learning_to_simulate import models
from tests.learning_to_simulate import synthetic as modes
from tests.pca_tools import synthetic
from tests.pca_tools.commands import call_command

SHORT = {'soil_particles': 60, 'latent_size': 8, 'message_passing_steps': 2, 'num_steps': 6}


@pytest.fixture(scope='module')
def folders(tmp_path_factory):
    """{scene: (dataset, raw runs)} of both scenes. Not to be changed."""
    base = tmp_path_factory.mktemp('full_space')
    made = {}
    for name in ('excavation', 'wheel'):
        raw = synthetic.write_raw_folder(str(base / f'raw_{name}'), name, range(1, 13))
        convert.convert(raw, str(base / name))
        made[name] = (str(base / name), raw)
    return made


def make(folder, raw=None, **overrides):
    """An untrained model with random weights and its training runs."""
    config = presets.make_config('full_space', **SHORT | overrides)
    metadata = dataset.read_metadata(folder)
    group = read_runs(folder, raw, 'train', metadata, config.soil_particles)
    model = particles.make_model(folder, metadata, group, config)
    rng = np.random.default_rng(0)
    for variable in model.simulator.trainable_variables:
        variable.assign(rng.normal(0.0, 0.3, variable.shape))
    return model, group


def state_of(group):
    """Position, velocities and coming displacement of the body in the middle of the first run."""
    position, velocity = group.position[0, 8], np.diff(group.position[0, 3:9], axis=0)
    return position, velocity, group.position[0, 9, : group.n_rigid] - position[: group.n_rigid]


def test_neighbours_are_those_of_brute_force():
    rng = np.random.default_rng(0)
    position, n_rigid, radius = rng.uniform(0, 1, (80, 3)), 9, 0.3
    found = set(zip(*(ends.tolist() for ends in neighbour_list(position, radius, n_rigid))))
    near = np.linalg.norm(position[:, None] - position[None], axis=-1) <= radius
    wanted = {(s, r) for s, r in np.argwhere(near) if s != r and (s >= n_rigid or r >= n_rigid)}
    assert found == wanted and len(wanted) > 100


def test_radius_of_a_lattice_reaches_its_nearest_shells():
    """Of 27 in a unit cube, the 14th neighbour is a corner of the cell or the next point along."""
    lattice = np.stack(np.meshgrid(*[np.arange(12.0)] * 3), axis=-1).reshape(-1, 3)
    assert np.sqrt(2) < typical_radius(lattice) < 2.0


def test_network_equals_numpy_edge_by_edge():
    network = ParticleNetwork(8, 2, 2, 6)
    rng = np.random.default_rng(1)
    nodes, edges = rng.normal(size=(5, 7)), rng.normal(size=(9, 4))
    senders, receivers = rng.integers(0, 5, (2, 9)).astype(np.int32)
    result = network(
        tf.constant(nodes, tf.float32), tf.constant(edges, tf.float32), senders, receivers
    )
    weights = {v.name: v.numpy().astype(float) for v in network.trainable_variables}

    def mlp(name, x, norm=True):
        w = [v for k, v in weights.items() if f'/{name}/' in k and 'layer_norm' not in k]
        for i, pair in enumerate(zip(w[::2], w[1::2])):
            bias, matrix = sorted(pair, key=np.ndim)
            x = x @ matrix + bias
            x = np.maximum(x, 0) if i < 2 else x
        if norm:  # scale 1 and offset 0 as initialised
            x = (x - x.mean(-1, keepdims=True)) / np.sqrt(x.var(-1, keepdims=True) + 1e-5)
        return x

    n, e = mlp('encode_nodes', nodes), mlp('encode_edges', edges)
    for m in range(2):
        messages = np.stack(
            [
                mlp(f'edges_{m}', np.concatenate([e[k], n[r], n[s]]))
                for k, (s, r) in enumerate(zip(senders, receivers))
            ]
        )
        received = np.zeros_like(n)
        for k, r in enumerate(receivers):
            received[r] += messages[k]
        n, e = n + mlp(f'nodes_{m}', np.concatenate([received, n], axis=1)), e + messages
    np.testing.assert_allclose(result, mlp('decode', n, norm=False), atol=2e-4)


def test_moved_scene_moves_the_prediction(folders):
    """Everything shifted by whole metres, walls too: the displacements stay, to round-off."""
    model, group = make(*folders['wheel'])
    simulator, n = model.simulator, group.n_rigid
    position, velocity, body = state_of(group)
    here = simulator.step(position, velocity, body, group.context[0], n)
    shift = np.array([3.0, -7.0, 11.0])
    for wall in (simulator.statistics.low, simulator.statistics.high):
        wall += shift
    there = simulator.step(position + shift, velocity, body, group.context[0], n)
    np.testing.assert_allclose(there[0], here[0], rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(there[1], here[1], rtol=1e-3)
    assert there[2] == here[2] > 100


def test_twice_the_speed_is_twice_the_motion(folders):
    """But for what the rate itself changes."""
    model, group = make(*folders['excavation'])
    simulator, n = model.simulator, group.n_rigid
    position, velocity, body = state_of(group)
    (first_layer,) = (
        v for v in simulator.trainable_variables
        if 'encode_nodes' in v.name and v.shape[0] == 3 * (1 + 3) + 2
    )  # fmt: skip
    first_layer.assign(np.where(np.arange(14)[:, None] == 13, 0.0, first_layer))  # log of the rate
    once, force, _ = simulator.step(position, velocity, body, None, n)
    twice, same, _ = simulator.step(position, 2 * velocity, 2 * body, None, n)
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-4)
    np.testing.assert_allclose(same, force, rtol=1e-4)  # of soil without inertia


def test_given_motion_is_followed_and_only_the_height_is_predicted(folders):
    for name, free in (('excavation', []), ('wheel', [1])):
        model, group = make(*folders[name])
        rollout = ParticleEvaluator(model, {}).roll_out(group.select(0))
        error = (rollout.position - group.position[:1, 6:])[0, :, : group.n_rigid]
        given = [axis for axis in range(3) if axis not in free]
        np.testing.assert_allclose(error[..., given], 0.0, atol=1e-9)
        # What is wrong is the same for all particles: the wheel stays rigid.
        np.testing.assert_allclose(error - error[:, :1], 0.0, atol=1e-9)


def test_particles_are_those_of_the_raw_runs_or_decoded(folders):
    folder, raw = folders['excavation']
    metadata = dataset.read_metadata(folder)
    whole = read_runs(folder, raw, 'test', metadata, 70)
    case = metadata['cases']['test'][0]['case']
    stored = files.read_npz(f'{raw}/run_{case:03d}.npz')
    np.testing.assert_array_equal(whole.position[0, :, 20:], stored['positions'][:, ::2])
    decoded = read_runs(folder, None, 'test', metadata, 70)
    error = ((decoded.position - whole.position)[:, :, 20:] ** 2).mean()
    # Half of the particles: their error is like the mean of all, within a factor of two.
    assert 0.5 < error / np.mean(metadata['projection_mse']['test']) < 2.0


def command(folders, path, *extra):
    """Runs the command on the raw runs of the blade."""
    folder, raw = folders['excavation']
    given = f'--data_path={folder}', f'--model_path={path}', f'--raw_path={raw}'
    with models.eagerly():
        done = call_command('learning_to_simulate.train', *given, *extra)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope='module')
def trained(folders, tmp_path_factory):
    """A model that the command has trained. Not to be changed."""
    path = str(tmp_path_factory.mktemp('trained') / 'model')
    command(folders, path, '--model=full_space', *(f'--set={k}={v}' for k, v in SHORT.items()))
    return path


def test_command_rolls_out(folders, trained, tmp_path):
    out = str(tmp_path / 'out')
    command(folders, trained, f'--output_path={out}', '--mode=eval_rollout')
    summary = json.loads((tmp_path / 'out' / 'metrics.json').read_text())
    values = files.read_npz(f'{out}/rollout_test_0.npz')
    error = (values['predicted_rollout'] - values['ground_truth_rollout']).astype(float)
    soil = error[:, values['particle_types'] == particles.SOIL_TYPE]
    row = summary['runs']['model'][0]
    assert row['soil_mse'] == pytest.approx((soil**2).mean(), rel=1e-3, abs=1e-12)
    assert row['peak_memory_mb'] > 50 and row['edges'] > 100
    assert {'stay_still', 'constant_velocity', 'model'} <= summary['mean'].keys()


def stepped_like_the_rollout(path, folder):
    """A stepper of a model after some frames of a recorded run, each as that rolls out."""
    model, run = lts.load(path), lts.Dataset(folder).test[0]
    rollout, group = model.rollout(run), model._opened(run.split).groups[0]
    n, live = group.n_rigid, model.stepper()
    assert 'no C form' in live.engine
    live.reset(group.position[0, :6], group.context_at(5, 0))
    for k in range(4):
        other = live.clone()
        frame = live.step(group.position[0, 6 + k, :n])
        np.testing.assert_allclose(frame.modes, rollout.modes[k], atol=1e-9)
        np.testing.assert_allclose(frame.force, rollout.force[k], rtol=1e-5)
        np.testing.assert_array_equal(other.step(group.position[0, 6 + k, :n]).modes, frame.modes)
        np.testing.assert_array_equal(frame.particles(), frame.modes.astype(np.float32))
    far = live.propose(group.position[0, 10, :n] + [0.5, 0, 0])
    assert far.status == 'left_bounds' and 'outside twice' in far.reason
    return live


def test_a_path_from_a_bed_at_rest(trained, tmp_path):
    """A blade with a whole path: it follows its path, the soil is drawn and saved."""
    model = lts.load(trained)
    begun = model.starts.pose[0]
    way = np.tile(begun, (5, 1))
    way[:, 0] -= 0.001 * np.arange(5)
    rollout = model.rollout(way)
    assert len(rollout) == 4 and rollout.particles().shape[1:] == rollout.modes.shape[1:]
    moved = rollout.body[-1] - rollout.body[5]
    np.testing.assert_allclose(moved, np.tile([-0.004, 0.0, 0.0], (len(moved), 1)), atol=1e-12)
    rollout.save(str(tmp_path / 'rollout.npz'))
    rollout.render(str(tmp_path / 'rollout.png'))
    stored = files.read_npz(str(tmp_path / 'rollout.npz'))
    n = (stored['particle_types'] == particles.SOIL_TYPE).sum()
    assert n == model.scene.n_modes and (tmp_path / 'rollout.png').stat().st_size > 5000
    with pytest.raises(ValueError, match='has no C form'):
        model.stepper(engine='c')


def test_soil_without_a_body_is_stepped(folders):
    folder, _ = folders['excavation']
    metadata, config = dataset.read_metadata(folder), presets.make_config('full_space', **SHORT)
    whole = read_runs(folder, None, 'train', metadata, 60)
    group = dataclasses.replace(
        whole, n_rigid=0, position=whole.position[:, :, whole.n_rigid :],
        particle_type=whole.particle_type[whole.n_rigid :],
    ).select(0)  # fmt: skip
    model = particles.make_model(folder, metadata, group, config, 'none')
    live = Stepper(model, n_rigid=0, make_step=particles.Step)
    live.reset(group.position[0, :6])
    rollout = ParticleEvaluator(model, {}).roll_out(group)
    for k in range(3):
        frame = live.step()
        np.testing.assert_allclose(frame.modes, rollout.position[0, k], atol=1e-12)
    assert np.abs(frame.modes - group.position[0, 5]).max() > 0
    assert frame.rigid_pose.shape == (0, 3)


def test_training_learns_resumes_and_refuses(folders, tmp_path):
    """A driven wheel, on particles that are decoded: what the subspace cuts off is stated beside
    the error."""
    folder, raw = folders['wheel']
    path = str(tmp_path / 'model')
    config = presets.make_config('full_space', **SHORT | {'noise_std': 0.0})
    with models.eagerly():
        summary = registry.train(folder, path, config)
    row = summary['runs']['model'][0]
    assert 1e-6 * row['soil_mm'] ** 2 > row['soil_mse'] > 0 and row['rigid_mse'] > 0
    before = files.read_npz(f'{path}/{checkpoints.WEIGHTS_FILE}')
    registry.train(folder, path, config)
    opened = particles.open_model(path, folder, 'valid')
    for variable, stored in zip(opened.model.simulator.trainable_variables, before.values()):
        np.testing.assert_array_equal(variable.numpy(), stored)
    metadata = dataset.read_metadata(folder)
    begun = read_runs(folder, None, 'train', metadata, config.soil_particles)
    untrained = particles.make_model(folder, metadata, begun, config)
    losses = [
        ParticleTrainer(m, opened.groups[0]).one_step_errors(5)['loss']
        for m in (opened.model, untrained)
    ]
    assert losses[0] < 0.95 * losses[1]
    live = stepped_like_the_rollout(path, folder)
    assert live.particles().shape == (opened.model.simulator.scene.n_modes, 3)
    with pytest.raises(ValueError, match='trained on particles of decoded .*: leave --raw_path'):
        particles.open_model(path, folder, 'test', raw_path=raw)
    with pytest.raises(ValueError, match='noise_std=0.3 contradicts'):
        registry.open_model(path, folder, 'test', {'noise_std': 0.3})


def test_bad_data_is_refused(folders, tmp_path):
    folder, raw = folders['excavation']
    metadata = dataset.read_metadata(folder)
    few = synthetic.write_raw_folder(str(tmp_path / 'few'), 'excavation', [1])
    for path, message in ((few, 'lacks the runs'), (folders['wheel'][1], 'of another dataset')):
        with pytest.raises(ValueError, match=message):
            read_runs(folder, path, 'train', metadata, 60)
    with pytest.raises(FileNotFoundError, match='no such folder of raw runs'):
        read_runs(folder, str(tmp_path / 'gone'), 'train', metadata, 60)
    with pytest.raises(ValueError, match='soil_particles is 200, but the runs have 140'):
        read_runs(folder, raw, 'train', metadata, 200)
    alone = modes.write_dataset(tmp_path / 'alone')
    with pytest.raises(FileNotFoundError, match='needs the raw runs'):
        read_runs(alone, None, 'train', dataset.read_metadata(alone), 60)
    with pytest.raises(ValueError, match='soil_particles is 0'):
        presets.make_config('full_space', soil_particles=0)
    with pytest.raises(ValueError, match='no settings .*unroll_steps'):
        presets.make_config('full_space', unroll_steps=10)
