"""The folded form of a step against the plain one, on every kind of body and network."""

import functools

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate import rollout
from learning_to_simulate.compiled.folded_step import FoldedStep, rollout_function
from learning_to_simulate.compiled.step_form import PlainStep
from learning_to_simulate.compiled.two_pass import AheadPass, FramePass
from tests.learning_to_simulate import models

PREDICTED = {'preset': 'pcg_thesis', 'motion': 'predicted', 'rigid_counts': (6,), 'context': True}
SECOND_ORDER = {'velocity_inputs': 5, 'rate_scaled': False, 'mode_order': 2, 'rigid_order': 2}
CASES = {
    'prescribed': {},
    'prescribed, contact': {'contact': True},
    'prescribed, contact, torque': {
        'contact': True, 'torque': True, 'overrides': {'predict_torque': True},
    },
    'prescribed, two steps': {'overrides': {'message_passing_steps': 2}},
    'prescribed, history': {'overrides': {'velocity_inputs': 5, 'hidden_layers': 1}},
    'prescribed, no force': {'force': False, 'overrides': {'message_passing_steps': 2}},
    'prescribed, full graph': {'preset': 'fcg_original'},
    'prescribed, full graph, three steps': {
        'preset': 'fcg_original',
        'overrides': {'message_passing_steps': 3, 'latent_size': 15},
    },
    'prescribed, published': {'preset': 'pcg_thesis'},
    'prescribed, second order': {'overrides': SECOND_ORDER},
    'prescribed, path': {'overrides': {'path_inputs': True}},
    'prescribed, path and places': {
        'overrides': {'path_inputs': True, 'mode_order': 0, 'rate_scaled': False}
    },
    'driven': {'motion': 'driven', 'context': True},
    'driven, two steps, history': {
        'motion': 'driven',
        'overrides': {'message_passing_steps': 2, 'velocity_inputs': 3},
    },
    'driven, full graph': {'motion': 'driven', 'overrides': {'adjacency': 'fully_connected'}},
    'driven, second order': {'motion': 'driven', 'overrides': SECOND_ORDER},
    'driven, published': {
        'motion': 'driven',
        'preset': 'pcg_thesis',
        'overrides': {'predict_driven_body': False},
    },
    'predicted': PREDICTED,
    'predicted, conditioned': PREDICTED | {'preset': 'pcg', 'force': False},
    'predicted, two steps': PREDICTED | {'overrides': {'message_passing_steps': 2}},
    'predicted, torque': PREDICTED | {'torque': True, 'overrides': {'predict_torque': True}},
}  # fmt: skip
N_FRAME = 8
IN_THE_LOOP = ('prescribed, full graph, three steps', 'driven, two steps, history')
VARIANTS = [(case, {}) for case in CASES] + [
    (case, switch) for case in IN_THE_LOOP for switch in ({'ahead': False}, {'dense': False})
]


def _inputs(model, group):
    inputs = rollout.rollout_inputs(group, model.layout(group.n_rigid), model.simulator.scene)
    state, known, context, _ = inputs
    if known is not None:
        frames = {name: getattr(known, name)[:N_FRAME] for name in ('offset', 'velocity')}
        path = None if known.path is None else known.path[:N_FRAME]
        known = known._replace(**frames, path=path)
    return state, known, context, N_FRAME


def _tolerance(values, share):
    """A share of their range, but not below one unit in the last place: a force of an untrained
    network may hardly vary about a large mean, where that share is less than float32 can tell."""
    return max(share * _range(values), float(np.spacing(np.abs(values).max())))


def _range(values):
    return np.ptp(values.numpy(), axis=(0, 1)).max()


@pytest.mark.parametrize('case, switch', VARIANTS, ids=[f'{c} {s}' for c, s in VARIANTS])
def test_same_as_the_plain_rollout(tmp_path, case, switch):
    """Four runs as one batch. Eagerly, to save the compilation: the functions are the same."""
    model, (group, *_), _ = models.make(tmp_path, **CASES[case])
    inputs = _inputs(model, group)
    layout = model.layout(group.n_rigid)
    tf.config.run_functions_eagerly(True)
    try:
        expected = rollout.RolloutFunction(model.simulator, layout)(*inputs)
        folded = functools.partial(FoldedStep, **switch)
        got = rollout.RolloutFunction(model.simulator, layout, make_step=folded)(*inputs)
    finally:
        tf.config.run_functions_eagerly(False)
    # Round-off grows in an untrained network: measured up to 2e-6 of the range in 12 frames. The
    # plain loop takes the height as a mean of float32 offsets, whose last digit counts where its
    # change is an input: measured 3e-4 of the range of the force.
    heights = model.simulator.statistics.height_std is not None
    assert got[0].shape == expected[0].shape
    np.testing.assert_allclose(got[0], expected[0], atol=_tolerance(expected[0], 2e-5), rtol=0)
    if expected[1] is None:
        assert got[1] is None
    else:
        share = 1e-3 if heights else 2e-5
        np.testing.assert_allclose(got[1], expected[1], atol=_tolerance(expected[1], share), rtol=0)


def test_compiled_rollout_follows_weights_that_training_changed(tmp_path):
    """Variables are read in every call."""
    model, (group,), _ = models.make(tmp_path)
    layout = model.layout(group.n_rigid)
    function = rollout.RolloutFunction(model.simulator, layout, make_step=FoldedStep)
    plain = rollout.RolloutFunction(model.simulator, layout)
    inputs = _inputs(model, group.select(0))
    for _ in range(2):
        for got, expected in zip(function(*inputs), plain(*inputs), strict=True):
            np.testing.assert_allclose(got, expected, atol=_tolerance(expected, 2e-5), rtol=0)
        for variable in model.simulator.trainable_variables:
            variable.assign(variable * 1.1)


def test_a_model_without_a_graph_keeps_the_plain_rollout(tmp_path):
    model, (group,), _ = models.make(tmp_path, preset='mlp', overrides={'mode_edges': 0})
    function = rollout_function(model.simulator, model.layout(group.n_rigid))
    step = function._make_step(model.simulator, function.layout, True)
    assert isinstance(step, PlainStep)


def test_two_passes_do_what_one_does():
    """Calls of known values run once for all frames, the rest once per frame, each with its own."""
    calls = []

    def model(do, known, state):
        def double(x):
            calls.append('ahead')
            return {'twice': 2 * x, 'same': x}

        def add(parts, y):
            calls.append('frame')
            return parts['twice'] + y

        return do('sum', add, do('double', double, known), state)

    known = tf.reshape(tf.range(6.0), [3, 2, 1])
    ahead = AheadPass(n_frame=3)
    assert model(ahead, tf.reshape(known, [6, 1]), None) is None
    results = [model(FramePass(ahead.results, k), known[k], tf.ones([2, 1])) for k in range(3)]
    np.testing.assert_array_equal(tf.stack(results), 2 * known + 1)
    assert calls == ['ahead', 'frame', 'frame', 'frame']
