"""Nodes that a config leaves out: modes, and particles of a body that turns."""

import dataclasses

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate import (
    checkpoints,
    connectivity_utils,
    evaluation,
    presets,
    reading_utils,
    registry,
    rollout,
)
from learning_to_simulate.subspace.learned_simulator import Layout
from learning_to_simulate.subspace.rigid_body import KnownMotion
from pca_tools import dataset, files, rigid_fit, subspace
from tests.learning_to_simulate import models, synthetic

H = 6
RING = {'motion': 'driven', 'rigid_counts': (8,)}


def _roll_out(model, group):
    """One run, eagerly."""
    tf.config.run_functions_eagerly(True)
    try:
        function = rollout.RolloutFunction(model.simulator, model.layout(group.n_rigid))
        return rollout.roll_out(function, group.select(0))
    finally:
        tf.config.run_functions_eagerly(False)


def test_fewer_modes_are_judged_against_all_of_the_dataset(tmp_path):
    model, (group, *_), metadata = models.make(tmp_path, overrides={'modes': 2, 'mode_edges': 4})
    assert model.simulator.scene.n_modes == 2 and group.position.shape[2] == 4 + 2
    run = dataset.read_split(str(tmp_path), 'train')[0]
    result = _roll_out(model, group)
    summary = evaluation.summarise([(0, group.select(0), result)], model, metadata, 'train')
    # By hand: errors of the two modes, and all of the third.
    truth = run.position[H:].astype(np.float64)
    error = (result.position[0, :, 4:] - truth[:, 4:6], truth[:, 6:])
    expected = sum((e**2).sum() for e in error) / (len(truth) * 3 * synthetic.N_SOIL)
    np.testing.assert_allclose(summary['mean']['model']['soil_mse'], expected, rtol=1e-12)
    # The trivial predictors know all modes: they are the same for every model of the dataset.
    still = ((truth - run.position[H - 1].astype(np.float64))[:, 4:] ** 2).sum()
    still /= len(truth) * 3 * synthetic.N_SOIL
    np.testing.assert_allclose(summary['mean']['stay_still']['soil_mse'], still, rtol=1e-12)
    (path, _) = evaluation.save_rollouts(
        str(tmp_path / 'out'), 'train', [(0, group.select(0), result)], summary, metadata
    )
    written = files.read_npz(path)
    np.testing.assert_array_equal(written['ground_truth_rollout'], run.position[H:])
    assert written['predicted_rollout'].shape == truth.shape
    assert not written['predicted_rollout'][:, 6].any()
    np.testing.assert_array_equal(written['particle_types'], run.particle_type)


def test_fewer_modes_make_particles_and_are_loaded_again(tmp_path):
    model, (group, *_), metadata = models.make(
        tmp_path / 'data', overrides={'modes': 2, 'mode_edges': 4}
    )
    space = subspace.fit([np.random.default_rng(0).normal(size=(9, synthetic.N_SOIL, 3))], 3)
    stepper = models.stepper(model, group.n_rigid, space)
    stepper.reset(group.position[0, :H])
    modes = stepper.step(group.position[0, H, : group.n_rigid]).modes
    full = np.concatenate([modes, np.zeros((1, 3))])
    np.testing.assert_allclose(stepper.particles(), space.decode(full), atol=1e-4)
    folder = tmp_path / 'model'
    folder.mkdir()
    checkpoints.save_config(str(folder), model, group.n_rigid, {})
    checkpoints.save_weights(str(folder), model.simulator)
    opened = registry.open_model(str(folder), str(tmp_path / 'data'), 'test')
    again, (test, *_) = opened.model, opened.groups
    assert again.simulator.scene.n_modes == 2 and test.position.shape[2] == group.position.shape[2]
    with pytest.raises(ValueError, match='has 1 modes, the model in .* the first 2'):
        checkpoints.check_dataset(str(folder), again, 'other', metadata | {'mode_number': 1})
    with pytest.raises(ValueError, match='has 3 modes, 4 were asked for'):
        reading_utils.read_groups(str(tmp_path / 'data'), 'test', metadata, modes=4)


def test_thinned_body_keeps_its_height_and_comes_back_rigid(tmp_path):
    model, (group, *_), _ = models.make(tmp_path, overrides={'rigid_stride': 2}, **RING)
    run = dataset.read_split(str(tmp_path), 'train')[0]
    body = run.position[:, :8].astype(np.float64)
    np.testing.assert_array_equal(group.kept[0], [0, 2, 4, 6])
    height = body[:, :, 1].mean(axis=1) - body[0, :, 1].mean()
    kept = group.position[0, :, :4, 1].mean(axis=1)
    # What the model predicts is the height of the axle, not of some point that turns around it.
    np.testing.assert_allclose(kept - kept[0], height, atol=1e-6)
    position = _roll_out(model, group).position
    (whole,) = group.select(0).all_particles(position)
    # The untrained height differs from the true one; everything else is given.
    lift = position[0, :, :4, 1].mean(axis=1) - group.position[0, H:, :4, 1].mean(axis=1)
    expected = body[H:] + lift[:, None, None] * [0.0, 1.0, 0.0]
    assert np.abs(lift).max() > 1e-3
    np.testing.assert_allclose(whole[:, :8], expected, atol=1e-5)
    for frame in whole[[0, -1]]:
        assert rigid_fit.fit_rigid_motion(body[0], frame[:8]).residual < 1e-5
    (true,) = group.select(0).all_particles(group.position[:1], as_recorded=True)
    np.testing.assert_allclose(true, run.position, atol=1e-6)


def test_rollout_that_blew_up_is_written_as_such(tmp_path):
    _, (group, *_), _ = models.make(tmp_path, overrides={'rigid_stride': 2}, **RING)
    position = group.position[:1, H:].copy()
    position[0, 3:] = np.nan
    (whole,) = group.select(0).all_particles(position)
    assert np.isfinite(whole[:3]).all() and np.isnan(whole[3:]).all()


@pytest.mark.parametrize('stride', [3, 4])
def test_thinning_that_moves_the_axle_is_refused(tmp_path, stride):
    with pytest.raises(ValueError, match='train record 0: rigid_stride keeps [23] of 8 .* needs'):
        models.make(tmp_path, overrides={'rigid_stride': stride}, **RING)


def test_neighbours_of_a_thinned_body_skip_what_is_left_out():
    ring = [(i, (i + d) % 8) for i in range(8) for d in (1, 7)]
    two_rings = ring + [(s + 8, r + 8) for s, r in ring]
    small = {(i, (i + d) % 4) for i in range(4) for d in (1, 3)}
    expected = small | {(s + 4, r + 4) for s, r in small}
    kept = np.arange(16)[::2]
    assert set(connectivity_utils.contracted_edges(two_rings, 16, kept)) == expected
    assert connectivity_utils.contracted_edges([(1, 0)], 2, [0, 1]) == ((1, 0),)
    with pytest.raises(ValueError, match='particle 15, the body has 8'):
        connectivity_utils.contracted_edges(two_rings, 8, kept)


@pytest.mark.parametrize(
    'fields', [{'modes': -1}, {'rigid_stride': 0}, {'preset': 'full_space', 'modes': 2}]
)
def test_impossible_choices_are_refused(fields):
    with pytest.raises(ValueError, match='modes|rigid_stride'):
        presets.make_config(**{'preset': 'pcg'} | fields)


def test_edges_of_particles_above_the_ground_do_not_exist_in_that_frame(tmp_path):
    """The same prediction as that of a graph which never had those edges."""
    model, (group, *_), _ = models.make(tmp_path)
    simulator, layout = model.simulator, model.layout(group.n_rigid)
    lasting, n, up = simulator.config, layout.n_rigid, simulator.scene.up_axis
    heights = group.position[0, H - 1 :, :n, up]
    surfaces = (float(heights.min()) - 0.01, float(np.median(heights)), float(heights.max()))
    seen = set()
    for surface, frame in zip(surfaces, (H, 20, 30), strict=True):
        frames = group.position[:1, frame - H : frame + 1]
        offset = frames - layout.origin
        state = rollout.initial_state(offset[:, :-1], np.diff(frames[:, :-1], axis=1))
        motion = (offset[:, -1, :n], frames[:, -1, :n] - frames[:, -2, :n])
        known = KnownMotion(*(tf.constant(x, tf.float32) for x in motion))
        in_soil = np.append(heights[frame - H] <= surface, np.ones(layout.n_node - n, bool))
        kept = in_soil[layout.senders] & in_soil[layout.receivers]
        seen.add(int(kept.sum()))
        mask = np.zeros((layout.n_node, layout.n_node), bool)
        mask[layout.receivers[kept], layout.senders[kept]] = True
        adjacency = connectivity_utils.Adjacency.from_mask(mask)
        fewer = Layout(adjacency, n, simulator.scene, simulator.statistics, lasting)
        expected, force = simulator.step(state, known, None, fewer)
        simulator.config = dataclasses.replace(lasting, surface_height=surface)
        got, same = simulator.step(state, known, None, layout)
        simulator.config = lasting
        np.testing.assert_allclose(got.offset, expected.offset, atol=1e-6)
        np.testing.assert_allclose(same, force, rtol=1e-4, atol=1e-4)
    assert seen == {5, 11, layout.n_edge}  # None of the body's edges, those of one row, and all.


def test_a_tool_depth_needs_a_graph():
    with pytest.raises(ValueError, match='surface_height'):
        presets.make_config('mlp', surface_height=0.3)
