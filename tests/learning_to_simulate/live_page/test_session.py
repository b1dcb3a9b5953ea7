"""The session without a browser: steering, limits, status, recorded runs, files."""

import io

import numpy as np
import pytest

import learning_to_simulate as lts
from learning_to_simulate.live import poses
from learning_to_simulate.live_page import recorded, session
from learning_to_simulate.live_page.limits import Limits
from learning_to_simulate.live_page.session import LIMITED, OK, OUTSIDE, STOPPED
from pca_tools import rigid_fit
from tests.learning_to_simulate.live_page import sessions

FRAMES = 120


def run(shown, frames=FRAMES):
    return [shown.advance() for _ in range(frames)]


def edge(shown):
    """Height of the lowest particle of the body, m."""
    placed = poses.placed(shown.body(), shown.moment.pose)
    return placed[:, shown.scene.up_axis].min()


@pytest.mark.parametrize('depth, angle', [(10.0, 0.0), (25.0, -15.0), (-5.0, -30.0)])
def test_sliders_bring_the_blade_to_depth_angle_and_speed(depth, angle):
    shown = sessions.make('excavation')
    shown.steering.set('angle', angle)
    shown.steering.set('depth', depth)
    run(shown)
    assert edge(shown) == pytest.approx(shown.level - depth / 1e3, abs=1e-6)
    assert np.rad2deg(shown.plane[2]) == pytest.approx(angle, abs=1e-6)
    shown.steering.set('speed', 60.0)
    start = shown.plane[0]
    moments = run(shown, 60)
    assert shown.forwards * (shown.plane[0] - start) == pytest.approx(0.06, abs=1e-6)
    assert {m.lamp for m in moments} == {OK}
    assert moments[-1].force[0] * shown.forwards < 0  # the soil holds the blade back


def test_frames_are_those_of_the_same_path_rolled_out_and_the_file_has_them():
    shown = sessions.make('excavation')
    shown.steering.set('depth', 20.0)
    shown.steering.set('speed', 80.0)
    moments = run(shown, 70)
    with np.load(io.BytesIO(shown.rollout_file())) as file:
        force = file['predicted_forces']
    live = np.stack([m.force for m in moments])
    np.testing.assert_allclose(live, force, atol=1e-4 * np.abs(force).max())
    assert len(shown.path()) == 71


def test_a_tool_that_is_thrown_about_stays_within_the_training_runs():
    """Random targets far outside: the judge of the frames, not the limits, says it is within."""
    shown, random = sessions.make('excavation'), np.random.default_rng(5)
    lamps = set()
    for _ in range(12):
        shown.steering.aim(shown.plane + random.normal(size=3) * [0.5, 0.3, 1.0])
        lamps |= {m.lamp for m in run(shown, 15)}
    assert LIMITED in lamps and OUTSIDE not in lamps


def test_a_wheel_starts_within_the_training_runs_and_standing_is_not():
    shown = sessions.make('wheel')
    assert {m.lamp for m in run(shown)} == {OK}
    shown.steering.set('rotation', 0.0)
    last = run(shown, 2)[-1]
    assert last.lamp == OUTSIDE and 'displacement of the body' in last.reason


def test_a_wheel_at_the_end_of_its_way_stops_before_it_digs_itself_in():
    shown = sessions.make('wheel')
    run(shown, 3)
    side = 0 if shown.forwards < 0 else 1
    shown._limits.low[0] += 0.18 * (side == 0)
    shown._limits.high[0] -= 0.18 * (side == 1)
    moments = run(shown, 200)
    last = moments[-1]
    assert last.lamp == STOPPED and last.frame < 200 == len(moments)
    assert 'held back along the drive: the training runs end at' in last.reason
    assert last.reason.endswith('reset (R)')
    turned = shown.plane[2]
    assert run(shown, 3)[-1].frame == last.frame and shown.plane[2] == turned
    shown.reset()
    assert run(shown, 3)[-1].lamp == OK


def test_soil_that_leaves_the_training_runs_is_told_of_before_the_page_stops(monkeypatch):
    shown = sessions.make('wheel')
    low, high = shown.model.model.simulator.statistics.position_range
    monkeypatch.setattr(session, 'FAR', 0.6)
    last = run(shown, 30)[-1]
    modes = shown._live._last.modes
    far = np.abs(2 * modes - (low + high)[1:])[:, 0] / (high - low)[1:, 0]
    assert far.max() > 0.6 and last.lamp == OUTSIDE
    assert last.reason.startswith('the soil has moved') and 'at 2 times' in last.reason
    monkeypatch.setattr(session, 'FAR', 1.5)
    assert run(shown, 1)[-1].lamp == OK


def test_a_wheel_of_a_field_drives_within_its_training_and_shows_its_sinkage():
    shown = session.Session(lts.load('wheel_v2/swept_field'))
    start = shown.plane
    moments = run(shown, 6)
    assert {m.lamp for m in moments} == {OK}
    assert (shown.plane[0] - start[0]) * shown.forwards > 0
    lowest = shown.moment.pose[1] - shown.model.starts.cases[shown.start]['diameter_m'] / 2
    assert shown.sinkage == pytest.approx(shown.level - lowest, abs=1e-6)
    assert sessions.make('excavation').sinkage is None
    ends = shown.travel()
    assert ends[0] < shown.plane[0] < ends[1] and ends[1] - ends[0] < 0.13


def test_without_limits_the_page_says_what_is_unlike_training():
    shown = sessions.make('excavation')
    shown.within = False
    shown.steering.aim(shown.plane + [-0.2 * shown.forwards, 0.3, 0.0])
    moments = run(shown)
    assert moments[-1].lamp in (OUTSIDE, STOPPED) and 'is outside' in moments[-1].reason
    assert all(np.isfinite(m.particles).all() for m in moments)


def test_limits_hold_a_body_to_places_speeds_and_angles():
    shown = sessions.make('excavation')
    limits = shown._limits
    for wanted in ([5.0, 0.3, 0.0], [0.5, -2.0, 0.0], [0.6, 0.4, 3.0]):
        now, reasons = shown.plane, []
        for _ in range(300):
            after, reason = limits.step(now, wanted)
            moved = limits.nodes(after) - limits.nodes(now)
            assert np.clip(moved, *limits.speed) == pytest.approx(moved, abs=1e-9)
            points = limits.nodes(after)
            assert (points >= limits.low - 1e-9).all() and (points <= limits.high + 1e-9).all()
            reasons.append(reason)
            now = after
        assert reasons[-1]


def test_a_body_that_is_outside_may_come_back_but_not_go_on():
    shown = sessions.make('excavation')
    limits, away = shown._limits, shown.plane + [0.0, 0.2, 0.0]
    up, _ = limits.step(away, away + [0.0, 0.01, 0.0])
    down, _ = limits.step(away, away - [0.0, 0.01, 0.0])
    assert up[1] == pytest.approx(away[1]) and down[1] < away[1] - 1e-3


def test_a_wheel_rolls_with_its_slip_and_stops_where_it_is_sent():
    shown = sessions.make('wheel')
    shown.steering.set('slip', 20.0)
    start = shown.plane
    run(shown, 60)
    rotation, radius = shown.steering.sliders['rotation'].value, shown.steering.radius
    travel, turned = (shown.plane - start)[[0, 2]]
    assert abs(turned) == pytest.approx(rotation, rel=1e-9)  # rad in a second
    assert travel * shown.forwards == pytest.approx(0.8 * rotation * radius, rel=1e-3)
    # It turns as the recorded wheels do.
    recorded_run = shown.recorded.runs['test 0, case 9']
    before, after = (recorded_run.pose(frame) for frame in (0, 100))
    motion = rigid_fit.fit_rigid_motion(
        poses.placed(shown.body(), before), poses.placed(shown.body(), after)
    )
    assert np.sign(motion.rotation[1, 0]) == np.sign(turned)
    shown.steering.aim(shown.plane + [0.004 * shown.forwards, 0.0, 0.0])
    place = shown.plane[0]
    run(shown, 60)
    assert abs(shown.plane[0] - place) < 0.006


@pytest.mark.parametrize('name', ['excavation', 'wheel'])
def test_recorded_runs_are_followed_to_their_end_and_can_be_left(name):
    shown = sessions.make(name)
    label, solver = next(iter(shown.recorded.runs.items()))
    shown.reset(label)
    moments = run(shown, len(solver) + 5)
    assert moments[-1].frame == len(solver) - 1 and 'has ended' in moments[-1].reason
    if name == 'excavation':  # the model is nearer to the solver's soil than the soil at rest
        error, moved = (
            sum(np.square(x(m) - solver.particles(m.frame)).mean() for m in moments[:300:20])
            for x in (lambda m: m.particles, lambda m: shown.rest)
        )
        assert error < 0.5 * moved
    path = shown.path()
    level = np.arange(3) != shown.scene.up_axis
    np.testing.assert_allclose(path[:, :3][:, level], solver.poses[:, :3][:, level], atol=1e-9)
    shown.take_over()
    assert shown.run is None
    assert shown.advance().frame == len(solver)


def test_a_refused_pose_holds_the_tool_and_the_next_one_goes_on(monkeypatch):
    shown = sessions.make('excavation')
    step, refusals = shown._live.step, iter([True, True])

    def sometimes(pose):
        if next(refusals, False):
            raise ValueError('the pose jumps: 9 m/s')
        return step(pose)

    monkeypatch.setattr(shown._live, 'step', sometimes)
    shown.steering.set('depth', 10.0)
    first, _, third = run(shown, 3)
    assert first.lamp == STOPPED and first.reason == 'the pose jumps: 9 m/s' and first.frame == 0
    assert third.lamp == OK and third.frame == 1 and len(shown.path()) == 2


def test_a_prediction_that_is_nonsense_is_not_shown(monkeypatch):
    shown = sessions.make('excavation')
    run(shown, 3)
    good, step = shown.moment, shown._live.step

    def broken(pose):
        frame = step(pose)
        return frame._replace(now=session.RolloutStatus.LEFT_BOUNDS)

    monkeypatch.setattr(shown._live, 'step', broken)
    shown.advance()
    assert shown.moment.lamp == STOPPED and shown.moment.particles is good.particles
    monkeypatch.undo()
    assert shown.advance().lamp == STOPPED  # until the reset
    shown.reset()
    assert shown.advance().lamp == OK


def test_context_and_start_change_the_wheel():
    shown = sessions.make('wheel')
    starts = shown.model.starts
    other = int(np.argmax(starts.context[:, 2]))
    shown.reset(start=other)
    assert shown.context['load'] == pytest.approx(starts.context[other, 2])
    heavy = run(shown, 60)[-1]
    light = {**shown.context, 'load': float(starts.context[:, 2].min())}
    shown.reset(context=light)
    assert shown.context == light and shown.start == other
    up = shown.scene.up_axis
    assert run(shown, 60)[-1].force[up] < heavy.force[up]  # less soil carries less


def test_what_is_not_there_is_refused_and_nothing_changes(tmp_path):
    shown = sessions.make('excavation')
    run(shown, 2)
    with pytest.raises(ValueError, match="no recorded run 'test 99'.*test 0"):
        shown.reset('test 99')
    assert shown.moment.frame == 2
    with pytest.raises(ValueError, match='is of the scene wheel'):
        recorded.RecordedRuns(sessions.model('excavation'), lts.Dataset('wheel'))
    with pytest.raises(FileNotFoundError, match='no folder with a metadata.json'):
        recorded.of_model(sessions.model('excavation'), str(tmp_path))
    shown.reset()
    with pytest.raises(ValueError, match='no frame yet'):
        shown.rollout_file()


def test_a_pose_in_the_plane_and_back():
    for up, lateral in ((1, 0.4), (2, -0.1)):
        reader = poses.PoseReader(up, lateral)
        for angle in (-3.0, -0.4, 0.0, 1.2, 3.1):
            plane = [0.3, 0.2, angle]
            np.testing.assert_allclose(reader.plane(reader.read(plane)), plane, atol=1e-12)
            np.testing.assert_allclose(
                reader.plane(reader.read(plane) * [1, 1, 1, -1, -1, -1, -1]), plane, atol=1e-12
            )


def test_a_model_without_ranges_has_no_limits():
    class Bare:
        model = object()

    assert Limits.of(Bare, None, None) is None
