"""The graph network on degenerate graphs and features."""

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate import presets, reading_utils
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout import RolloutFunction, roll_out
from learning_to_simulate.subspace import graph_network, learned_simulator, method
from learning_to_simulate.subspace.trainer import Trainer
from pca_tools import dataset
from tests.learning_to_simulate import models
from tests.test_shipped import ROOT

# V nodes and the [sender, receiver] edges of one graph.
GRAPHS = {
    'no nodes': (0, []),
    'no edges': (5, []),
    'one node, no edge': (1, []),
    'one node, self-edge': (1, [(0, 0)]),
    'isolated node': (4, [(0, 1), (1, 0), (2, 1)]),
    'senders only': (3, [(0, 2), (1, 2)]),
}


@pytest.mark.parametrize('mean', [True, False], ids=['mean', 'sum'])
@pytest.mark.parametrize('graph', GRAPHS.values(), ids=GRAPHS)
def test_degenerate_graphs_are_finite(graph, mean):
    """Also in batches, and a node without incoming edges does not see the others."""
    n_node, edges = graph
    ends = np.array(edges, np.int32).reshape(-1, 2)
    network = graph_network.EncodeProcessDecode(8, 2, 2, 6, mean)
    rng = np.random.default_rng(0)
    nodes = rng.normal(size=(3, n_node, 4)).astype(np.float32)
    features = rng.normal(size=(3, len(edges), 4)).astype(np.float32)

    def run(nodes):
        return network(tf.constant(nodes), tf.constant(features), *ends.T).numpy()

    out = run(nodes)
    assert out.shape == (3, n_node, 6) and np.isfinite(out).all()
    lonely = np.setdiff1d(np.arange(n_node), ends[:, 1])
    if len(lonely) and n_node > 1:
        moved = nodes + np.arange(n_node, dtype=np.float32)[:, None]
        moved[:, lonely[0]] = nodes[:, lonely[0]]
        np.testing.assert_allclose(run(moved)[:, lonely[0]], out[:, lonely[0]], atol=1e-6)


def test_gradient_at_coincident_nodes_is_finite(tmp_path):
    """All nodes at one place: every edge has length 0, where tf.norm would give NaN."""
    model, _, _ = models.make(tmp_path, preset='fcg_original', motion='predicted')
    layout = model.layout(4)
    velocity = tf.zeros([1, layout.n_node, H - 1, 3])
    offset = tf.Variable(-layout.origin[None].astype(np.float32))
    with tf.GradientTape() as tape:
        state = learned_simulator.SimulatorState(offset, velocity)
        target, force = model.simulator.predict(state, None, None, layout)
        loss = tf.reduce_sum(target**2) + tf.reduce_sum(force**2)
    gradients = tape.gradient(loss, [offset, *model.simulator.trainable_variables])
    assert all(g is None or np.isfinite(tf.convert_to_tensor(g)).all() for g in gradients)
    assert gradients[0] is not None


def test_noise_arrives_as_it_was_drawn():
    """Noise of 6.7e-6 on shipped records with scores of several metres.

    In velocity units it arrives to 6e-6 of itself; in absolute float32 positions it would lose 6 to
    12 %.
    """
    folder = str(ROOT / 'datasets' / 'excavation')
    metadata = dataset.read_metadata(folder)
    groups = reading_utils.read_groups(folder, 'valid', metadata)
    config = presets.make_config('pcg_thesis', latent_size=16)
    trainer = Trainer(method.make_model(folder, metadata, groups, config), groups)
    tensors = trainer._tensors[0]
    offset, velocity, *_ = tensors.windows(64, H + 1, tf.constant([1, 2]))
    noisy = trainer._noisy_state(offset, velocity, tensors.layout, tf.constant([3, 4]))
    clean = learned_simulator.initial_state(offset[:, :H], velocity[:, 1:H])
    drawn = trainer._noisy_state(0 * offset, 0 * velocity, tensors.layout, tf.constant([3, 4]))
    moving = tensors.layout.moving.all(axis=1)
    lost = (noisy.velocity - clean.velocity - drawn.velocity).numpy()[:, moving]
    # Measured 6e-6 and less: rounding of velocities of up to 2 cm per frame.
    assert np.sqrt(np.mean(lost**2)) / 6.7e-6 < 1e-4
    assert np.sqrt(np.mean(drawn.velocity.numpy()[:, moving, -1] ** 2)) > 5e-6
    placed = (noisy.offset - clean.offset - drawn.offset).numpy()[:, moving]
    # Measured 1e-3: float32 offsets of some metres.
    assert np.sqrt(np.mean(placed**2)) / 6.7e-6 < 1e-2


def test_rollout_is_traced_once_per_size_and_gives_the_same_bits(tmp_path):
    """Other runs, other values, other weights: no new trace. Another batch: one more."""
    model, (group,), _ = models.make(tmp_path, context=True, motion='driven')
    function = RolloutFunction(model.simulator, model.layout(group.n_rigid))
    first, *_, again = (roll_out(function, group.select(run)) for run in (0, 1, 2, 0))
    assert first.position.tobytes() == again.position.tobytes()
    assert first.force.tobytes() == again.force.tobytes()
    for variable in model.simulator.trainable_variables:
        variable.assign(1.1 * variable)
    roll_out(function, group.select(0))
    assert function._run.experimental_get_tracing_count() == 1
    roll_out(function, group)
    assert function._run.experimental_get_tracing_count() == 2
