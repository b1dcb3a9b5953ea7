"""A model in a subspace in C: the judgement of rollouts, saved states, particles, starts. Its steps
are held against numpy in `subspace/test_learned_simulator`."""

import ctypes
import dataclasses

import numpy as np
import pytest

from learning_to_simulate import rollout_status
from learning_to_simulate.native import library
from learning_to_simulate.native.binding import CSubspace
from learning_to_simulate.rollout_status import NodeRanges
from pca_tools import subspace
from tests.learning_to_simulate import models, synthetic
from tests.learning_to_simulate.native import worlds

H = 6

pytestmark = worlds.needs_c


@pytest.fixture(scope='module')
def shared(tmp_path_factory):
    """A prescribed body in C, its model, and runs."""
    model, group, *_ = worlds.graph(tmp_path_factory.mktemp('model'))
    return CSubspace.of(model, group.n_rigid, subspace=worlds.space()), model, group


def kind_of(bits):
    """The worst of status bits, as `RolloutStatus`."""
    c = library.constants()
    kinds = 'non_finite', 'left_bounds', 'extrapolating'
    return next((kind for kind in kinds if bits & c[f'LTS_{kind.upper()}']), 'ok')


def judged(soil):
    """The fields of `Judgement` since the start of a `CSubspace`, by lts_judge and lts_reason."""
    found, text = library.structures()['lts_judgement'](), ctypes.create_string_buffer(200)
    soil.call('judge', ctypes.byref(found))
    soil.call('reason', text, len(text))
    return kind_of(found.status), found.frame, found.node, text.value.decode()


@pytest.mark.parametrize('motion, limit', [('prescribed', 45.0), ('driven', 34.0)])
def test_status_agrees_with_the_judgement_of_rollouts(tmp_path, motion, limit):
    """Starts, bodies and contexts inside and outside of training, forces above and below twice the
    limit, of runs and of each frame alone: kind, frame, node, and the reason in words."""
    model, group, starts, _ = worlds.graph(tmp_path, motion=motion, context=True)
    n, s = group.n_rigid, model.simulator
    starts = dataclasses.replace(starts, force_limit=limit)
    stepper, seen, alone, reasons = CSubspace.of(model, n, starts=starts), set(), set(), set()
    ranges = NodeRanges(n, s.statistics, s.scene, limit)
    for seed in range(24):
        rng = np.random.default_rng(seed)
        truth, context = group.position[seed % 4].copy(), group.context[seed % 4].copy()
        if seed % 3:  # far enough for the soil to leave its bounds, or too fast for a frame
            frame, size = rng.integers(0, len(truth)), 0.3 if seed % 3 == 1 else 0.01
            truth[frame:, rng.integers(n), rng.integers(3)] += rng.choice([-1, 1]) * size
        if seed % 4 == 1:
            context[rng.integers(2)] *= 1.5
        if seed % 5 == 1:
            truth[:H, n + rng.integers(3)] += 4.0
        if seed % 8 == 7:  # far beyond float32's squares
            truth[20:, :n] += 1e25
        run = dataclasses.replace(group.select(0), position=truth[None], context=context[None])
        stepper.reset(truth[:H], context)
        frames = [stepper.step(pose) for pose in truth[H:, :n]]
        position = np.array([np.concatenate([f.rigid_pose, f.modes]) for f in frames])
        force = np.array([f.force for f in frames])
        (expected,) = rollout_status.judge(
            run, position[None], force[None], s.statistics, s.scene, limit
        )
        assert judged(stepper) == expected
        seen.add(expected.status)
        reasons.add(expected.reason.partition(' ')[0])
        if ranges.start(truth[H - 1], context, None).reason.startswith(s.scene.context_names):
            continue  # a context is judged with the start, and not in each frame
        for k, frame in enumerate(frames, H):
            body = truth[k, :n], truth[k - 1, :n]
            now = ranges.judge(k, position[k - H], frame.force, *body)
            assert kind_of(frame.status) == now.status
            alone.add(now.status)
    assert len(seen) == len(alone) == 4 and {'force', 'coordinate'} <= reasons


def test_prepare_save_and_clone_change_nothing(shared):
    stepper, _, group = shared
    n, rng = group.n_rigid, np.random.default_rng(0)
    stepper.reset(group.position[0, :H])
    plain = [stepper.step(pose) for pose in group.position[0, H:, :n]]
    stepper.reset(group.position[0, :H])
    other = [worlds.saved(stepper)]
    for k, pose in enumerate(group.position[0, H:, :n]):
        if rng.integers(2):
            stepper.call('prepare')
        if rng.integers(2):  # a detour, and back
            state = worlds.saved(stepper)
            stepper.step(pose + 0.01)
            worlds.restored(stepper, state)
        frame = stepper.step(pose)
        np.testing.assert_array_equal(frame.modes, plain[k].modes)
        np.testing.assert_array_equal(frame.force, plain[k].force)
        other.append(worlds.saved(stepper))
    assert len({len(state) for state in other}) == 1 and len(set(other)) == len(other)


def test_damaged_and_foreign_states_are_refused(tmp_path, shared):
    stepper, _, group = shared
    stepper.reset(group.position[0, :H])
    state = worlds.saved(stepper)
    model, (foreign, *_), _ = models.make(tmp_path, overrides={'seed': 1})
    bad = [b'', state[:-1], state[:40] + b'?' + state[41:], state[:-3] + b'???']
    bad.append(worlds.saved(CSubspace.of(model, foreign.n_rigid)))
    for value in bad:
        with pytest.raises(ValueError, match='saved state'):
            worlds.restored(stepper, value)
    assert worlds.saved(stepper) == state


def test_bad_input_is_refused(shared):
    """What is refused of steps and histories, live/test_stepper says."""
    stepper, model, group = shared
    n, pose = group.n_rigid, group.position[0, H, : group.n_rigid]
    fresh = CSubspace.of(model, n)
    for call in (lambda: fresh.step(pose), lambda: fresh.call('prepare'), fresh.particles):
        with pytest.raises(ValueError, match='not started|subspace'):
            call()
    with pytest.raises(ValueError, match="kernel is 'gpu'"):
        CSubspace.of(model, n, kernel='gpu')
    with pytest.raises(ValueError, match='subspace has'):
        CSubspace.of(model, n, subspace=subspace.fit([np.random.rand(9, 20, 3)], synthetic.N_MODES))
    with pytest.raises(ValueError, match='outside its range'):
        worlds.started(stepper)


def test_models_without_a_c_form_are_refused_by_name(tmp_path):
    model, (group,), _ = models.make(tmp_path, preset='mixer_se', overrides={'mode_edges': 0})
    with pytest.raises(ValueError, match="'mixer_se' has no C form; exported are gns, mlp"):
        CSubspace.of(model, group.n_rigid)


def test_particles_and_heights(shared):
    stepper, _, group = shared
    stepper.reset(group.position[0, :H])
    frame = stepper.step(group.position[0, H, : group.n_rigid])
    particles = worlds.space().decode(frame.modes)
    np.testing.assert_allclose(stepper.particles(), particles, atol=1e-5)
    low, cell, shape = particles.min(axis=0)[[0, 2]] + 0.3, 0.7, (5, 4)
    expected = np.full(shape, np.nan)
    for x, y, z in stepper.particles().astype(float):
        i, j = np.floor((np.array([x, z]) - low) / cell).astype(int)
        if 0 <= i < shape[0] and 0 <= j < shape[1]:
            expected[i, j] = np.nanmax([expected[i, j], y])
    got = worlds.height_map(stepper, low, cell, shape)
    np.testing.assert_array_equal(got, expected.astype(np.float32))
    assert np.isnan(got).any() and np.isfinite(got).any()
    for bad in ({'cell': 0.0}, {'shape': (0, 3)}, {'origin': [np.nan, 0]}, {'shape': (10**9, 3)}):
        with pytest.raises(ValueError):
            worlds.height_map(stepper, **{'origin': low, 'cell': cell, 'shape': shape} | bad)


@pytest.mark.parametrize('motion', ['prescribed', 'driven', 'predicted'])
def test_a_start_by_pose_is_a_reset_from_rest(tmp_path, motion):
    """Poses stand for the points of the start's body, turned and moved."""
    model, group, found, values = worlds.graph(tmp_path, motion=motion, context=True)
    n, dt, start = group.n_rigid, model.simulator.scene.dt, values['starts'][2]
    stepper, other = (CSubspace.of(model, n, starts=found) for _ in range(2))
    centre, arms = start['points'].mean(axis=0), start['points'] - start['points'].mean(axis=0)

    def points(angle, shift):  # about z
        c, s = np.cos(angle), np.sin(angle)
        return centre + shift + arms @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])

    def pose(angle, shift):
        return np.r_[centre + shift, np.cos(angle / 2), 0, 0, np.sin(angle / 2)]

    velocity, turning = np.array([-0.06, 0.012, 0.0]), 0.3
    history = np.stack(
        [
            np.concatenate([points(0.1 + turning * t, velocity * t), start['modes']])
            for t in dt * np.arange(1 - H, 1)
        ]
    )
    twist = np.r_[velocity, 0, 0, turning]
    worlds.started(stepper, -1, pose(0.1, 0.0), twist, start['context'])
    other.reset(history, start['context'])
    for k in range(1, 5):
        shift, angle = velocity * k * dt, 0.1 + turning * k * dt
        if motion == 'predicted':
            a, b = stepper.step(), other.step()
        else:
            a = worlds.step_at(stepper, pose(angle, shift))
            b = other.step(points(angle, shift))
        np.testing.assert_allclose(a.modes, b.modes, atol=1e-7)
        np.testing.assert_allclose(a.force, b.force, rtol=1e-4, atol=1e-4)
    for bad in ({'start': 9}, {'pose': np.zeros(7)}, {'twist': [np.inf] * 6}, {'context': [1.0]}):
        with pytest.raises(ValueError):
            worlds.started(stepper, **bad)
