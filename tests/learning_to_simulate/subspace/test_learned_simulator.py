"""One step against a numpy twin, and what must hold for any weights."""

import graph_nets as gn
import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout import RolloutFunction, roll_out, rollout_inputs
from learning_to_simulate.subspace import graph_network, learned_simulator, rigid_body
from tests.learning_to_simulate import models
from tests.learning_to_simulate.twins.numpy_twin import Twin

CASES = {
    'pcg': {'preset': 'pcg'},
    'pcg, all velocities': {'overrides': {'velocity_inputs': 5}},
    'pcg, second order': {
        'overrides': {'mode_order': 2, 'rigid_order': 2, 'rate_scaled': False, 'velocity_inputs': 5}
    },
    'pcg, driven, context': {'motion': 'driven', 'context': True},
    'pcg, predicted': {'motion': 'predicted'},
    'pcg_thesis': {'preset': 'pcg_thesis'},
    'pcg_thesis, driven': {
        'preset': 'pcg_thesis',
        'motion': 'driven',
        'context': True,
        'rigid_motion': 'driven',
    },
    'fcg_original, two steps': {
        'preset': 'fcg_original',
        'overrides': {'message_passing_steps': 2},
    },
    'fcg_original, predicted': {'preset': 'fcg_original', 'motion': 'predicted'},
    'pcg, torque': {'overrides': {'predict_torque': True}, 'torque': True},
    'pcg_thesis, torque': {
        'preset': 'pcg_thesis', 'overrides': {'predict_torque': True}, 'torque': True,
    },
}  # fmt: skip


def first_step(model, group, run=0):
    """Positions [V, 3] and force [3] of frame H by the package, for one run."""
    one = group.select(run)
    layout = model.layout(group.n_rigid)
    state, known, context, _ = rollout_inputs(one, layout, model.simulator.scene)
    if known is not None:
        known = rigid_body.KnownMotion(known.offset[0], known.velocity[0])
    state, force = model.simulator.step(state, known, context, layout)
    return state.offset[0].numpy() + layout.origin, force[0].numpy()


@pytest.mark.parametrize('case', CASES.values(), ids=CASES)
def test_step_equals_the_numpy_twin(case, tmp_path):
    model, (group,), _ = models.make(tmp_path, **case)
    position, force = first_step(model, group)
    context = None if group.context is None else group.context[0]
    expected, expected_force = Twin(model, group.n_rigid).step(
        group.position[0, :H], group.position[0, H, : group.n_rigid], context
    )
    # Measured over the cases: displacements 4e-6 of their range, force 3e-6; float32 round-off of
    # sums over about 100 terms. Ten times that.
    before = group.position[0, H - 1]
    moved = np.abs(expected - before).max()
    np.testing.assert_allclose(position - before, expected - before, atol=4e-5 * moved)
    np.testing.assert_allclose(force, expected_force, atol=3e-5 * np.abs(expected_force).max())


@pytest.mark.parametrize(
    'overrides',
    [{'velocity_inputs': 5}, {'path_inputs': True, 'mode_order': 0, 'rate_scaled': False}],
    ids=['displacements', 'places'],
)
def test_what_was_true_reproduces_the_run(tmp_path, monkeypatch, overrides):
    """Integration alone (LagrangeBench's test): what was true goes in, the truth comes out."""
    model, groups, _ = models.make(tmp_path, overrides=overrides)
    group, simulator = groups[0], model.simulator
    layout = model.layout(group.n_rigid)
    state, known, context, n_frame = rollout_inputs(group, layout, simulator.scene)
    truth = tf.constant(group.velocity, tf.float32)
    frame = {'now': H}

    def cheat(state, known, context, layout):
        target = simulator.normalized_target(truth[:, frame['now']], state, known, layout)
        return target, tf.zeros([len(target), 3])

    monkeypatch.setattr(simulator, 'predict', cheat)
    for k in range(n_frame):
        frame['now'] = H + k
        coming = known.at(k)
        state, _ = simulator.step(state, coming, context, layout)
    error = np.abs(state.offset.numpy() + layout.origin - group.position[:, -1])
    assert error.max() < 1e-6 * np.ptp(group.position[:, :, group.n_rigid :], axis=1).max()


def test_batch_of_runs_equals_single_runs(tmp_path):
    model, (group,), _ = models.make(tmp_path, context=True, motion='driven')
    function = RolloutFunction(model.simulator, model.layout(group.n_rigid))
    together = roll_out(function, group)
    for run in range(len(group.position)):
        alone = roll_out(function, group.select(run))
        scale = np.ptp(group.position[run], axis=0).max()
        np.testing.assert_allclose(together.position[run], alone.position[0], atol=2e-5 * scale)
        np.testing.assert_allclose(together.force[run], alone.force[0], rtol=1e-4)


def test_scene_without_a_part_has_no_variable_for_it(tmp_path):
    """Absent means absent: no force head, no context inputs, no look at the coming frame."""

    def width(name, **case):
        model, _, _ = models.make(tmp_path / name, **case)
        first = [
            v for v in model.simulator.trainable_variables if 'node_model/mlp/linear_0/w' in v.name
        ]
        last = [v for v in model.simulator.trainable_variables if 'decoder/linear_2/w' in v.name]
        return first[0].shape[0], last[0].shape[1]

    inputs, outputs = width('plain')
    assert width('no force', force=False) == (inputs, outputs - 3)
    assert width('context', context=True) == (inputs + 4, outputs)  # two values, two logarithms
    predicted = width('predicted', motion='predicted')
    assert predicted == (inputs - 3 - 2, outputs)


def test_rate_scaling_makes_motion_proportional_to_the_body(tmp_path):
    """Twice the displacement of the body, history included, moves the soil twice as far.

    Exact but for the two rate inputs themselves, which the weights below ignore.
    """
    model, (group,), _ = models.make(tmp_path)
    weights = next(
        v for v in model.simulator.trainable_variables if 'node_model/mlp/linear_0/w' in v.name
    )
    values = weights.numpy()
    values[6:8] = 0.0  # inputs: 3 velocities, 3 positions, log rate, rate
    weights.assign(values)
    layout = model.layout(group.n_rigid)
    state, known, context, _ = rollout_inputs(group, layout, model.simulator.scene)
    moves = []
    for factor in (1.0, 2.0):
        scaled = learned_simulator.SimulatorState(state.offset, factor * state.velocity)
        coming = rigid_body.KnownMotion(known.offset[0], factor * known.velocity[0])
        after, _ = model.simulator.step(scaled, coming, context, layout)
        moves.append((after.velocity[:, layout.n_rigid :, -1]).numpy())
    np.testing.assert_allclose(moves[1], 2 * moves[0], rtol=1e-4, atol=1e-9)


def test_history_of_wrong_length_is_refused():
    with pytest.raises(ValueError, match='6 frames'):
        learned_simulator.initial_state(np.zeros([1, 5, 4, 3]), np.zeros([1, 4, 4, 3]))


def test_message_passing_equals_graph_nets():
    """The same weights in graph_nets' own InteractionNetwork give the same nodes and edges."""
    rng = np.random.default_rng(0)
    n_node, n_edge, width = 7, 20, 8
    nodes, edges = (rng.normal(size=(1, n, width)).astype(np.float32) for n in (n_node, n_edge))
    senders, receivers = rng.integers(0, n_node, (2, n_edge)).astype(np.int32)

    def make():
        return graph_network.mlp(width, 2)

    ours = graph_network._InteractionNetwork(make, 'processor')
    incidence = (np.arange(n_node)[:, None] == receivers).astype(np.float32)
    new_nodes, new_edges = ours(nodes, edges, senders, receivers, incidence)
    theirs = gn.modules.InteractionNetwork(make, make, name='processor')
    graph = gn.graphs.GraphsTuple(
        nodes=tf.constant(nodes[0]), edges=tf.constant(edges[0]), globals=None,
        senders=tf.constant(senders), receivers=tf.constant(receivers),
        n_node=tf.constant([n_node]), n_edge=tf.constant([n_edge]),
    )  # fmt: skip
    theirs(graph)
    names = {v.name: v for v in ours.trainable_variables}
    assert set(names) == {v.name for v in theirs.trainable_variables}
    for variable in theirs.trainable_variables:
        variable.assign(names[variable.name])
    update = theirs(graph)
    # Sums of 24 float32 terms in another order: 5e-7 seen.
    np.testing.assert_allclose(new_nodes[0], nodes[0] + update.nodes, atol=5e-6)
    np.testing.assert_allclose(new_edges[0], edges[0] + update.edges, atol=5e-6)
