"""One step of every network, in TensorFlow and in C, against numpy twins, and what must hold for
any weights."""

import graph_nets as gn
import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.native import library
from learning_to_simulate.native.binding import KERNELS, CSubspace
from learning_to_simulate.subspace import graph_network, learned_simulator
from tests.learning_to_simulate import models
from tests.learning_to_simulate.native import worlds
from tests.learning_to_simulate.twins.numpy_twin import Twin, WholeStateTwin

SECOND_ORDER = {
    'mode_order': 2, 'rigid_order': 2, 'rate_scaled': False, 'velocity_inputs': 5,
}  # fmt: skip
DRIVEN = {'motion': 'driven', 'context': True}
CASES = {
    'pcg': {},
    'pcg, second order': {'overrides': SECOND_ORDER},
    'pcg, three steps': {'overrides': {'message_passing_steps': 3, 'latent_size': 20}},
    'pcg, contact': {'contact': True},
    'pcg, driven': DRIVEN,
    'pcg, driven, second order, two steps': {
        'motion': 'driven',
        'overrides': SECOND_ORDER | {'message_passing_steps': 2},
    },
    'pcg, predicted': {'motion': 'predicted', 'rigid_counts': (6,)},
    'pcg_thesis, predicted': {'preset': 'pcg_thesis', 'motion': 'predicted', 'context': True},
    'pcg_thesis, driven': {'preset': 'pcg_thesis', 'rigid_motion': 'driven'} | DRIVEN,
    'fcg_original, two steps': {
        'preset': 'fcg_original',
        'overrides': {'message_passing_steps': 2},
    },
    'mlp, contact': {'preset': 'mlp', 'contact': True},
    'mlp, deeper, driven': DRIVEN
    | {'preset': 'mlp', 'overrides': {'velocity_inputs': 3, 'hidden_layers': 3}},
    'mlp, predicted': {'preset': 'mlp', 'motion': 'predicted', 'context': True, 'shaken': 0.3},
    'mixer_se': {'preset': 'mixer_se', 'shaken': 0.3},
    'mixer_scse, driven': {'preset': 'mixer_scse', 'shaken': 0.3} | DRIVEN,
    'mixer_scse, predicted': {'preset': 'mixer_scse', 'motion': 'predicted', 'shaken': 0.3},
}


@pytest.mark.parametrize('case', CASES.values(), ids=CASES)
def test_step_equals_the_numpy_twin(case, tmp_path):
    model, (group,), _ = models.make(tmp_path, **case)
    (position,), (load,) = models.steps(model, group, run=1)
    twin = Twin if model.simulator.config.has_graph else WholeStateTwin
    twin = twin(model, group.n_rigid)
    history, body = group.position[1, :H], group.position[1, H, : group.n_rigid]
    expected, expected_load = twin.step(history, body, group.context_at(H, 1))
    # Measured over the cases: displacements 4e-6 of their range, force 3e-6; float32 round-off of
    # sums over about 100 terms. Ten times that.
    before = history[-1]
    moved = np.abs(expected - before).max()
    np.testing.assert_allclose(position - before, expected - before, atol=4e-5 * moved)
    np.testing.assert_allclose(load, expected_load, atol=3e-5 * np.abs(expected_load).max())
    if not model.simulator.config.model.startswith('mixer') and library.shutil.which('cc'):
        assert_c(model, group, twin)


def assert_c(model, group, twin):
    """Single steps from recorded frames by every kernel; whole rollouts, with the driven height and
    the rigid correction, are compared in `live/test_stepper`."""
    n, known, space = group.n_rigid, model.simulator.scene.rigid_motion.is_known, worlds.space()
    for kernel in KERNELS:
        try:
            stepper = CSubspace.of(model, n, kernel, subspace=space, rigid_correction=False)
        except ValueError as error:
            assert 'this machine lacks kernel' in str(error)
            continue
        assert stepper.kernel == kernel
        for k in (H, H + 1, 20):
            history, body = group.position[1, k - H : k], group.position[1, k, :n]
            context = group.context_at(k, 1)
            expected, force = twin.step(history, body, context)
            stepper.reset(history, context)
            frame = stepper.step(body if known else None)
            moved = np.abs(expected - history[-1]).max()
            got = np.concatenate([frame.rigid_pose, frame.modes])
            # Measured 2e-6 of the displacement: float32 sums, and offsets of 1 m that keep 1e-7.
            np.testing.assert_allclose(got, expected, atol=2e-5 * moved + 1e-7)
            np.testing.assert_allclose(frame.force, force, atol=1e-5 * np.abs(force).max())
            # Of every column: the last panel of a kernel is not full.
            found, decoded = stepper.particles(), space.decode(frame.modes)
            np.testing.assert_allclose(found, decoded, atol=2e-6 * np.abs(decoded).max())


@pytest.mark.parametrize(
    'case',
    [{'overrides': {'velocity_inputs': 5}}, {'preset': 'mlp_driven'}],
    ids=['displacements', 'places'],
)
def test_what_was_true_reproduces_the_run(tmp_path, monkeypatch, case):
    """Integration alone (LagrangeBench's test): what was true goes in, the truth comes out."""
    model, (group,), _ = models.make(tmp_path, **case)
    simulator, frame = model.simulator, iter(range(H, 1000))
    truth = tf.constant(group.velocity[:1], tf.float32)

    def cheat(state, known, context, layout):
        target = simulator.normalized_target(truth[:, next(frame)], state, known, layout)
        return target, tf.zeros([len(target), 3])

    monkeypatch.setattr(simulator, 'predict', cheat)
    positions, _ = models.steps(model, group, count=group.position.shape[1] - H)
    error = positions - group.position[0, H:]
    assert np.abs(error[-1]).max() < 1e-6 * np.ptp(group.position[:, :, group.n_rigid :])


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
