"""Hard-concrete gates against their closed forms, and edges learned by `train.py`."""

import json
import pathlib
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate import checkpoints, presets, registry
from learning_to_simulate.subspace import edge_gates, edge_lists, subspace_model
from learning_to_simulate.subspace.edge_gates import (
    HIGH,
    LOW,
    OPEN_THRESHOLD,
    TEMPERATURE,
    EdgeGates,
)
from learning_to_simulate.subspace.trainer import Trainer
from learning_to_simulate.training import loop
from pca_tools import files
from tests.learning_to_simulate import models, synthetic

SEED = tf.constant([0, 1])
SHORT = {'latent_size': 8, 'hidden_layers': 1, 'num_steps': 8, 'unroll_steps': 0}
GATED = SHORT | {'gate_weight': 0.5, 'gate_steps': 5}


@pytest.fixture(scope='module')
def data(tmp_path_factory):
    """Without a validation split: its rollouts would be compiled anew for every training."""
    folder = synthetic.write_dataset(tmp_path_factory.mktemp('data'))
    (pathlib.Path(folder) / 'valid.tfrecord').unlink()
    return folder


@pytest.fixture(scope='module')
def trained(data, tmp_path_factory):
    """A model whose edges were learned in this process, from gates of which five are open. Not to
    be changed."""
    path = str(tmp_path_factory.mktemp('model') / 'gated')
    plain = EdgeGates.__init__

    def with_five(self, n_modes):
        plain(self, n_modes)
        self.log_alpha.assign(np.where(np.arange(9).reshape(3, 3) % 2, -3.0, 3.0))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, 'KEPT', 3)
        patch.setattr(EdgeGates, '__init__', with_five)
        with models.eagerly():
            registry.train(data, path, presets.make_config('pcg', **GATED), save_every=3)
    return path


def test_shares_of_shut_and_open_gates_are_those_of_the_paper():
    """P(0) and P(1) of a stretched, clipped concrete variable (Louizos et al. 2018), by drawing.

    P(s (HIGH - LOW) + LOW <= 0) with logit(s) = (logit(u) + log_alpha) / TEMPERATURE.
    """
    gates = EdgeGates(2)
    values = np.array([[-3.0, 0.0], [0.5, 4.0]])
    gates.log_alpha.assign(values)
    drawn = gates.sample(40_000, SEED).numpy()
    shut, whole = (drawn == 0).mean(axis=0), (drawn == 1).mean(axis=0)

    def probability_below(x):
        logit = np.log((x - LOW) / (HIGH - x))  # of s where the stretched value is x
        return 1 / (1 + np.exp(-(TEMPERATURE * logit - values)))

    # Five standard deviations of a share of 40 thousand draws: 0.0125.
    np.testing.assert_allclose(shut, probability_below(0.0), atol=0.0125)
    np.testing.assert_allclose(1 - whole, probability_below(1.0), atol=0.0125)
    np.testing.assert_allclose(gates.open_probability(), 1 - probability_below(0.0), rtol=1e-5)
    config = SimpleNamespace(gate_weight=3.0, gate_steps=10)
    price = gates.with_price({'loss': tf.constant(1.0)}, config, tf.constant(5))
    expected = (1 - probability_below(0.0)).mean()
    assert float(price['open_gates']) == pytest.approx(expected, rel=1e-5)
    assert float(price['loss']) == pytest.approx(1.0 + 3.0 * 0.5 * expected, rel=1e-5)


@pytest.mark.parametrize('logit', [-1e4, -20.0, 0.0, 1e4])
def test_gradient_is_finite_at_saturated_gates(logit):
    """And of the right sign where there is one: a price always pulls down, never up."""
    gates = EdgeGates(3)
    gates.log_alpha.assign(tf.fill([3, 3], logit))
    with tf.GradientTape() as tape:
        drawn = gates.sample(64, SEED)
        price = SimpleNamespace(gate_weight=1.0, gate_steps=1)
        values = gates.with_price({'loss': tf.reduce_sum(drawn)}, price, tf.constant(1))
    gradient = tape.gradient(values['loss'], gates.log_alpha).numpy()
    assert np.isfinite(drawn).all() and np.isfinite(gradient).all()
    assert (gradient >= 0).all() and (gradient > 0).all() == (logit in (-20.0, 0.0))
    if abs(logit) > 100:
        assert (drawn.numpy() == (logit > 0)).all()


def test_a_draw_of_zero_has_a_finite_gate(monkeypatch):
    """The uniform draw includes 0, once in 2^23."""
    monkeypatch.setattr(tf.random, 'stateless_uniform', lambda shape, seed: tf.zeros(shape))
    gates = EdgeGates(2)
    with tf.GradientTape() as tape:
        drawn = gates.sample(1, SEED)
    assert np.isfinite(tape.gradient(drawn, gates.log_alpha)).all() and not drawn.numpy().any()


def losses(model, group, layout):
    trainer = Trainer(model, [group])
    tensors = trainer._tensors[0].with_layout(layout)
    values = trainer._single_step_losses(tensors, 4, SEED, None)
    return {k: float(v) for k, v in values.items()}


@pytest.mark.parametrize('preset', ['pcg', 'fcg_original'])
def test_open_gates_are_the_dense_graph_and_shut_ones_no_edge(tmp_path, preset):
    """Mean and sum aggregation; losses over random windows, two message-passing steps."""
    overrides = {'adjacency': 'correlation', 'mode_edges': synthetic.N_MODES**2}
    overrides['message_passing_steps'] = 2
    model, (group,), _ = models.make(tmp_path, preset, overrides=overrides)
    dense = model.layout(group.n_rigid)
    gates = EdgeGates(synthetic.N_MODES)
    keep = np.random.default_rng(0).random((synthetic.N_MODES,) * 2) < 0.5
    for mask in (np.ones_like(keep), keep):
        gates.log_alpha.assign(np.where(mask, 1e3, -1e3))
        gated = losses(model, group, gates.gated(dense, 4, SEED))
        model.fix_mode_edges(mask)
        fixed = losses(model, group, model.layout(group.n_rigid))
        assert model.layout(group.n_rigid).n_edge == dense.n_edge - (~mask).sum()
        for name, value in fixed.items():  # float32 sums in another order: 1e-7 seen
            assert gated[name] == pytest.approx(value, rel=1e-5), name


def test_learned_edges_lie_beside_the_model_and_in_it(data, trained):
    edges = edge_lists.read(f'{trained}/edges.json')
    assert edges.method == 'gates' and edges.n_edge == 5 and edges.threshold == OPEN_THRESHOLD
    edges.check_data(data)
    model = subspace_model.load(trained)
    np.testing.assert_array_equal(model.mode_mask, edges.mask)
    assert model.edge_source == 'learned gates'
    assert model.layout(4).n_edge == 4 * synthetic.N_MODES + 5
    config = json.loads(pathlib.Path(f'{trained}/config.json').read_text())
    assert config['edges'] == {'4': 17}
    # The list can be given to a training of its own.
    path = f'{trained}/edges.json'
    chosen = edge_lists.choose(
        presets.make_config('pcg', adjacency=path), data, synthetic.N_MODES, None
    )
    np.testing.assert_array_equal(chosen.mode_mask, edges.mask)


@pytest.mark.parametrize('step', [3, 6], ids=['gates open', 'edges fixed'])
def test_training_resumes_to_the_same_weights_and_edges(data, trained, tmp_path, step):
    """From a checkpoint before and after the gates closed, as if killed right after it."""
    path = tmp_path / 'model'
    shutil.copytree(trained, path)
    for name in ('weights.npz', 'edges.json', *(p.name for p in path.glob('ckpt-*'))):
        if not name.startswith(f'ckpt-{step}.'):
            (path / name).unlink()
    assert loop.stored_steps(str(path)) == [step]
    with models.eagerly():
        registry.train(data, str(path), presets.make_config('pcg', **GATED), save_every=3)
    for name in ('edges.json', 'config.json'):
        assert (path / name).read_bytes() == pathlib.Path(trained, name).read_bytes()
    weights, straight = (files.read_npz(f'{p}/{checkpoints.WEIGHTS_FILE}') for p in (path, trained))
    for name in straight:
        np.testing.assert_array_equal(weights[name], straight[name])


def test_a_high_price_shuts_all_gates(data, tmp_path, monkeypatch):
    """What costs more than it helps goes, here at 20 times the rate; all are open at first."""
    monkeypatch.setattr(edge_gates, 'LEARNING_RATE', 0.4)
    settings = SHORT | {'gate_weight': 100.0, 'gate_steps': 24, 'num_steps': 25}
    model, groups, _ = models.make(tmp_path, overrides=settings)
    trainer = Trainer(model, groups)
    assert trainer.gates.edge_list(trainer.config, data).degenerate == 'saturated'
    for step in range(24):
        trainer.step(step)
    left = trainer.gates.edge_list(trainer.config, data)
    assert left.degenerate == 'empty' and left.n_edge == 0
