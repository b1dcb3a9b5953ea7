"""One stepper over its engines, by TensorFlow and by C: the same as the rollout; bad input."""

import gc
import sys

import numpy as np
import pytest

from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.native import library
from learning_to_simulate.rollout_status import RolloutStatus
from tests.learning_to_simulate import models
from tests.learning_to_simulate.native.worlds import needs_c, space

H = 6
KINDS = ['tensorflow', pytest.param('c', marks=needs_c)]


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """A model of a prescribed body, and runs."""
    model, (group, *_), _ = models.make(tmp_path_factory.mktemp('model'))
    return model, group


@pytest.fixture(scope='module')
def steppers(made):
    """By kind, one that is compiled once."""
    found = {}

    def stepper(kind):
        if kind not in found:
            found[kind] = models.stepper(made[0], made[1].n_rigid, space(), kind)
        return found[kind]

    return stepper


def _reset(stepper, group):
    return stepper.reset(group.position[0, :H], group.context_at(H - 1, 0))


CASES = {
    'prescribed': {},
    'driven': {'motion': 'driven', 'context': True},
    'driven, changing context': {'motion': 'driven', 'context': 'changing'},
    'predicted and corrected': {
        'motion': 'predicted', 'preset': 'pcg_thesis', 'rigid_counts': (6,)
    },
    'without a graph': {'preset': 'mlp', 'overrides': {'mode_edges': 0}},
    'path alone': {'preset': 'mlp_driven', 'overrides': {'mode_edges': 0}},
    'no force': {'force': False},
    'driven, two steps': {'motion': 'driven', 'overrides': {'message_passing_steps': 2}},
}  # fmt: skip

# What the engine of TensorFlow does with these the other cases hold.
BY_C = 'without a graph', 'no force', 'driven, two steps'


@pytest.mark.parametrize(
    'case', [c if c != 'path alone' else pytest.param(c, marks=pytest.mark.xla) for c in CASES]
)
def test_equals_the_rollout_frame_by_frame(tmp_path, case):
    model, (group, *_), _ = models.make(tmp_path, **CASES[case])
    n, known = group.n_rigid, model.simulator.scene.rigid_motion.is_known
    expected = models.rolled(model, group.select(0))
    scale = np.ptp(expected.position[0], axis=0).max()
    has_c = not case.startswith('path')
    kinds = ['best'] if has_c and library.shutil.which('cc') else []
    for kind in kinds if case in BY_C else ['tensorflow', *kinds]:
        stepper = models.stepper(model, n, space(), kind)
        assert stepper.engine.startswith('C (' if kind == 'best' else 'TensorFlow')
        _reset(stepper, group)
        for k, truth in enumerate(group.position[0, H:, :n]):
            context = group.context_at(H + k, 0) if group.context_changes else None
            frame = stepper.step(truth if known else None, context)
            got = np.concatenate([frame.rigid_pose, frame.modes])
            # Round-off of an untrained network over 34 frames: see test_rollout.
            np.testing.assert_allclose(got, expected.position[0, k], atol=3e-5 * scale)
            if expected.force is None:
                assert frame.force is None
                continue
            largest = np.ptp(expected.force, axis=1).max()
            np.testing.assert_allclose(frame.force, expected.force[0, k], atol=2e-3 * largest)
        np.testing.assert_allclose(frame.particles(), space().decode(frame.modes), atol=1e-4)
        assert frame.judgement[:3] == expected.judgements[0][:3]
    if not has_c:
        assert 'TensorFlow (the model has inputs' in models.stepper(model, n, kind='best').engine


@pytest.mark.xla
@pytest.mark.parametrize('kind', KINDS)
def test_many_steps_trace_nothing_and_keep_no_memory(made, steppers, kind):
    stepper, group = steppers(kind), made[1]
    _reset(stepper, group)
    pose = group.position[0, H - 1, : group.n_rigid]

    def kept(count):
        gc.collect()
        before = sys.getallocatedblocks()
        for _ in range(count):
            stepper.step(pose).particles()
        gc.collect()
        return sys.getallocatedblocks() - before

    kept(300)  # TensorFlow fills caches of its own
    # One Python object kept per step would be 200 each time; what other threads of the process
    # allocate meanwhile comes once.
    assert min(kept(200) for _ in range(4)) < 100
    if kind == 'tensorflow':
        assert stepper.computing._frame.experimental_get_tracing_count() == 1


@pytest.mark.parametrize('kind', KINDS)
def test_what_is_refused_held_proposed_or_cloned_leaves_no_trace(made, steppers, kind):
    stepper, group = steppers(kind), made[1]
    n, position = group.n_rigid, group.position[0]
    _reset(stepper, group)
    plain = [stepper.step(pose).modes for pose in position[H : H + 12, :n]]
    not_finite = position[H, :n].copy()
    not_finite[2, 1] = np.nan
    _reset(stepper, group)
    for k, pose in enumerate(position[H : H + 12, :n]):
        kept = stepper.clone()
        for bad, message in (
            (None, 'takes a pose'),
            (position[H, : n - 1], r'shape \(3, 3\), must be \(4, 3\)'),
            (not_finite, r'nan at \(2, 1\)'),
            ('here', 'not an array'),
        ):
            with pytest.raises(ValueError, match=message):
                stepper.step(bad)
        # A frame that is not finite is told and never becomes the state.
        assert stepper.step(pose + 1e37).now.status == RolloutStatus.NON_FINITE
        if k % 3 == 0:  # a detour of one of them
            stepper.step(pose + 0.01)
            stepper = kept
        stepper.propose(pose + 0.01)
        if k % 2:  # a clone knows nothing of what was proposed
            stepper = stepper.clone()
        seen = stepper.propose(pose)
        assert stepper.frame.modes is not seen.modes
        np.testing.assert_array_equal(seen.modes, plain[k])
        np.testing.assert_array_equal(stepper.step(pose).modes, plain[k])
    for bad in (position[: H - 1], position[:H, 1:], np.full_like(position[:H], np.inf)):
        with pytest.raises(ValueError, match='history'):
            stepper.reset(bad)
    with pytest.raises(ValueError, match='context'):
        stepper.reset(position[:H], [1.0])
    with pytest.raises(ValueError, match='cannot be divided'):
        stepper.step(position[H, :n], dt=1e-3)


def test_holds_or_raises_as_it_is_told(made, steppers):
    model, group = made
    poses = group.position[0, H:, : group.n_rigid]
    compiled = steppers('tensorflow').computing
    for outside in ('hold', 'raise'):
        stepper = Stepper(model, None, None, group.n_rigid, outside, lambda *_: compiled)
        _reset(stepper, group)
        before = stepper.step(poses[0])
        if outside == 'hold':
            held = stepper.step(poses[1] + 0.3)
            assert held.modes is before.modes and held.now.status != RolloutStatus.OK
        else:
            with pytest.raises(ValueError, match='(extrapolating|left_bounds): '):
                stepper.step(poses[1] + 0.3)
        assert stepper.step(poses[1]).now.status == RolloutStatus.OK
    with pytest.raises(ValueError, match="outside is 'stop'"):
        Stepper(model, n_rigid=group.n_rigid, outside='stop')


def test_before_the_start_and_of_what_does_not_fit_nothing_is_answered(made, steppers):
    model, n = made[0], made[1].n_rigid
    compiled = steppers('tensorflow').computing
    stepper = Stepper(model, n_rigid=n, make_step=lambda *_: compiled)
    calls = stepper.step, stepper.propose, lambda _: stepper.particles(), lambda _: stepper.frame
    for call in calls:
        with pytest.raises(ValueError, match='start'):
            call(np.zeros(7))
    with pytest.raises(ValueError, match="engine is 'gpu'"):
        models.stepper(model, n, kind='gpu')
    for other in (space(n_modes=2), space(n_soil=20)):
        with pytest.raises(ValueError, match='the subspace has'):
            models.stepper(model, n, other)
