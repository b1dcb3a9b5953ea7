"""Live stepping: the same as the rollout, nothing that grows, bad input without effect."""

import gc
import tracemalloc

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate import rollout
from learning_to_simulate.live import stepping
from pca_tools import subspace
from tests.learning_to_simulate import models, synthetic

H = 6


def _space(n_soil=synthetic.N_SOIL, n_modes=synthetic.N_MODES):
    runs = [np.random.default_rng(0).normal(size=(9, n_soil, 3))]
    return subspace.fit(runs, n_modes)


def _stepper(folder, **case):
    model, (group, *_), _ = models.make(folder, **case)
    return stepping.Stepper(model, group.n_rigid, _space()), model, group


@pytest.fixture(scope='module')
def shared(tmp_path_factory):
    """A stepper of a prescribed body, compiled once, its model, and runs."""
    return _stepper(tmp_path_factory.mktemp('model'))


def _reset(stepper, group):
    stepper.reset(group.position[0, :H], None if group.context is None else group.context[0])


@pytest.mark.parametrize(
    'case',
    [
        None,
        {'motion': 'driven', 'context': True},
        {'motion': 'predicted', 'preset': 'pcg_thesis', 'rigid_counts': (6,)},
        {'preset': 'mlp', 'overrides': {'mode_edges': 0}},
        {'preset': 'mlp_driven', 'overrides': {'mode_edges': 0}},
        {'overrides': {'path_inputs': True, 'mode_order': 0, 'rate_scaled': False}},
    ],
    ids=[
        'prescribed',
        'driven',
        'predicted and corrected',
        'without a graph',
        'path alone',
        'path and graph',
    ],
)
def test_equals_the_rollout_frame_by_frame(tmp_path, shared, case):
    """The rollout runs eagerly, to save its compilation: the function is the same."""
    stepper, model, group = shared if case is None else _stepper(tmp_path, **case)
    _reset(stepper, group)
    n = group.n_rigid
    function = rollout.RolloutFunction(model.simulator, model.layout(n))
    function.is_warm = True
    tf.config.run_functions_eagerly(True)
    try:
        expected = rollout.roll_out(function, group.select(0))
    finally:
        tf.config.run_functions_eagerly(False)
    given = model.simulator.scene.rigid_motion.is_known
    for k, truth in enumerate(group.position[0, H:]):
        frame = stepper.step(truth[:n] if given else None)
        got = np.concatenate([frame.rigid_pose, frame.modes])
        scale = np.ptp(expected.position[0], axis=0).max()
        # Round-off of an untrained network over 34 frames: see test_rollout.
        np.testing.assert_allclose(got, expected.position[0, k], atol=3e-5 * scale)
        np.testing.assert_allclose(
            frame.force, expected.force[0, k], atol=2e-3 * np.ptp(expected.force, axis=1).max()
        )
    np.testing.assert_allclose(stepper.particles(), _space().decode(frame.modes), atol=1e-4)
    assert stepper.traces == 1


def test_ten_thousand_steps_trace_nothing_and_keep_no_memory(shared):
    stepper, _, group = shared
    _reset(stepper, group)
    pose = group.position[0, H - 1, : group.n_rigid]

    def run(count):
        for _ in range(count):
            stepper.step(pose)
            stepper.particles()

    tracemalloc.start()
    run(2000)  # TensorFlow fills caches of its own, about 50 kB
    gc.collect()
    before = tracemalloc.get_traced_memory()[0]
    run(8000)
    gc.collect()
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    # Measured 2 to 50 kB, as TensorFlow fills its caches sooner or later; one Python float kept per
    # step would be 192 kB, one array 900 kB.
    assert stepper.traces == 1 and grown < 100_000


def test_bad_input_is_refused_and_changes_nothing(shared):
    stepper, _, group = shared
    n, position = group.n_rigid, group.position[0]
    _reset(stepper, group)
    not_finite = position[H, :n].copy()
    not_finite[2, 1] = np.nan
    for bad, message in (
        (None, 'takes a pose'),
        (position[H, : n - 1], r'shape \(3, 3\), must be \(4, 3\)'),
        (not_finite, r'nan at \(2, 1\)'),
        ('here', 'not an array'),
    ):
        with pytest.raises(ValueError, match=message):
            stepper.step(bad)
    for bad in (position[: H - 1], position[:H, 1:], np.full_like(position[:H], np.inf)):
        with pytest.raises(ValueError, match='history'):
            stepper.reset(bad)
    with pytest.raises(ValueError, match='context'):
        stepper.reset(position[:H], [1.0])
    after = stepper.step(position[H, :n])
    _reset(stepper, group)
    again = stepper.step(position[H, :n])
    np.testing.assert_array_equal(after.modes, again.modes)


def test_a_subspace_of_other_modes_or_particles_is_refused(tmp_path):
    model, (group,), _ = models.make(tmp_path)
    for space in (_space(n_modes=2), _space(n_soil=20)):
        with pytest.raises(ValueError, match='the subspace has'):
            stepping.Stepper(model, group.n_rigid, space)


def test_shipped_model_is_loaded_with_its_dataset():
    stepper = stepping.Stepper.load('models/excavation/pcg', 'datasets/excavation')
    with pytest.raises(ValueError, match='reset'):
        stepper.step(np.zeros((10, 3)))
    with pytest.raises(ValueError, match='reset'):
        stepper.particles()
    with pytest.raises(ValueError, match='wheel'):
        stepping.Stepper.load('models/excavation/pcg', 'datasets/wheel')
