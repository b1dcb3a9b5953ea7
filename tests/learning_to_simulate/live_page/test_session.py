"""The session without a browser: steering, limits, status, recorded runs, files."""

import functools
import io

import numpy as np
import pytest

import learning_to_simulate as lts
from learning_to_simulate.live import poses
from learning_to_simulate.live_page import recorded, session
from learning_to_simulate.live_page.session import LIMITED, OK, OUTSIDE, STOPPED
from learning_to_simulate.rollout_status import RolloutStatus
from pca_tools import rigid_fit

model = functools.cache(lts.load)
BLADE, WHEEL, BLADE_FIELD = 'excavation', 'wheel', 'excavation_v2'


@functools.cache
def runs(name):
    return recorded.of_model(model(name))


def make(name):
    return session.Session(model(name), runs(name))


def run(shown, frames=120):
    return [shown.advance() for _ in range(frames)]


@pytest.mark.parametrize(
    'name, depth, angle', [(BLADE, 10.0, 0.0), (BLADE, -5.0, -30.0), (BLADE_FIELD, 25.0, -15.0)]
)
def test_sliders_bring_the_blade_to_depth_angle_and_speed(name, depth, angle):
    shown = make(name)
    shown.steering.set('angle', angle)
    shown.steering.set('depth', depth)
    # Straight down a field goes no deeper than it knows, and says so; the rest comes on the way.
    presses = depth > 20.0
    assert run(shown)[-1].lamp == (LIMITED if presses else OK)
    assert shown.moment.reason.startswith('held back: pressed' if presses else '')
    shown.steering.set('speed', 60.0)
    start = shown.plane[0]
    moments = run(shown, 60)
    edge = poses.placed(shown.body(), shown.moment.pose)[:, shown.scene.up_axis].min()
    assert edge == pytest.approx(shown.level - depth / 1e3, abs=1e-6)
    assert np.rad2deg(shown.plane[2]) == pytest.approx(angle, abs=1e-6)
    assert shown.forwards * (shown.plane[0] - start) == pytest.approx(0.06, abs=1e-6)
    assert {m.lamp for m in moments} == {OK} and (shown.sinkage, moments[-1].frame) == (None, 180)
    if depth > 0:
        assert moments[-1].force[0] * shown.forwards < 0  # the soil holds the blade back
    live = np.stack([m.force for m in moments])
    with np.load(io.BytesIO(shown.rollout_file())) as file:
        force = file['predicted_forces'][-60:]
    np.testing.assert_allclose(live, force, atol=1e-4 * np.abs(force).max() + 1e-6)


@pytest.mark.parametrize('name', [BLADE, BLADE_FIELD])
def test_a_tool_that_is_thrown_about_stays_within_the_training_runs(name):
    """Random targets far outside; then it is held on one axis and goes on along another."""
    shown, random = make(name), np.random.default_rng(5)
    lamps = set()
    for _ in range(10):
        shown.steering.aim(shown.plane + random.normal(size=3) * [0.5, 0.3, 1.0])
        lamps |= {m.lamp for m in run(shown, 10)}
    assert LIMITED in lamps and OUTSIDE not in lamps
    shown.reset()
    shown.steering.aim(shown.plane + [0.0, 2.0, 0.0])
    shown.steering.set('speed', 50.0)
    first, last = run(shown, 90)[-2:]
    assert last.lamp == LIMITED and last.reason.startswith('held back: ')
    assert 'is outside' in last.reason and first.pose[1] == last.pose[1]
    assert (last.pose[0] - first.pose[0]) * shown.forwards == pytest.approx(0.05 / 60, rel=1e-6)
    shown.steering.set('depth', 0.0)
    assert run(shown, 1)[-1].lamp == OK


def test_without_limits_the_page_says_what_is_unlike_training_and_there_is_a_way_back():
    shown = make(BLADE)
    shown.within = False
    home = shown.plane.copy()
    shown.steering.aim(home + [0.0, 0.04, 0.0])
    moments = run(shown, 40)
    assert moments[-1].lamp == OUTSIDE and 'is outside' in moments[-1].reason
    assert all(np.isfinite(m.particles).all() for m in moments)
    shown.within = True
    shown.steering.aim(home)
    last = run(shown, 40)[-1]
    np.testing.assert_allclose(shown.plane, home, atol=1e-9)
    assert last.lamp == OUTSIDE and last.reason.startswith('was unlike the training runs')


def test_a_wheel_rolls_with_its_slip_and_stops_where_it_is_sent():
    shown = make(WHEEL)
    shown.steering.set('slip', 20.0)
    start = shown.plane
    assert {m.lamp for m in run(shown, 60)} == {OK}
    rotation, radius = shown.steering.sliders['rotation'].value, shown.steering.radius
    travel, turned = (shown.plane - start)[[0, 2]]
    assert abs(turned) == pytest.approx(rotation, rel=1e-9)  # rad in a second
    assert travel * shown.forwards == pytest.approx(0.8 * rotation * radius, rel=1e-3)
    # It turns as the recorded wheels do.
    before, after = (shown.recorded.runs['test 0, case 9'].pose(frame) for frame in (0, 100))
    motion = rigid_fit.fit_rigid_motion(
        poses.placed(shown.body(), before), poses.placed(shown.body(), after)
    )
    assert np.sign(motion.rotation[1, 0]) == np.sign(turned)
    shown.steering.aim(shown.plane + [0.004 * shown.forwards, 0.0, 0.0])
    place = shown.plane[0]
    stopped = run(shown, 60)[-1]  # standing is unlike its training, so it does not even do that
    assert abs(shown.plane[0] - place) < 0.006 and stopped.lamp == STOPPED
    assert 'displacement of the body' in stopped.reason
    shown.within = False
    assert run(shown, 1)[-1].lamp == OUTSIDE


def test_a_wheel_stops_where_its_training_ends_before_it_digs_itself_in():
    shown = make('wheel_v2')
    start = shown.plane[0]
    lowest = shown.moment.pose[1] - np.linalg.norm(shown.body()[:, :2], axis=1).max()
    assert shown.sinkage == pytest.approx(shown.level - lowest, abs=1e-6)
    shown.steering.set('slip', 0.0)
    while (last := shown.advance()).lamp == OK:
        assert last.frame < 400
    turned = shown.plane[2]
    assert (shown.plane[0] - start) * shown.forwards > 0.05
    assert last.lamp == STOPPED and last.reason.endswith('reset (R)')
    assert run(shown, 3)[-1].frame == last.frame and shown.plane[2] == turned
    shown.reset()
    assert {m.lamp for m in run(shown, 6)} == {OK}


@pytest.mark.parametrize('name', [BLADE, WHEEL])
def test_recorded_runs_are_followed_to_their_end_and_can_be_left(name):
    shown = make(name)
    label, solver = next(iter(shown.recorded.runs.items()))
    shown.reset(label)
    moments = run(shown, len(solver) + 5)
    assert moments[-1].frame == len(solver) - 1 and 'has ended' in moments[-1].reason
    if name == BLADE:  # the model is nearer to the solver's soil than the soil at rest
        error, moved = (
            sum(np.square(x(m) - solver.particles(m.frame)).mean() for m in moments[:300:20])
            for x in (lambda m: m.particles, lambda m: shown.rest)
        )
        assert error < 0.5 * moved
    level = np.arange(3) != shown.scene.up_axis
    path, true = (x[:, :3][:, level] for x in (shown.path(), solver.poses))
    np.testing.assert_allclose(path, true, atol=1e-9)
    shown.take_over()
    if name == WHEEL:  # it stands until it is given a speed
        shown.steering.set('slip', 40.0)
    assert shown.run is None and shown.advance().frame == len(solver)


def test_what_cannot_be_shown_holds_the_tool(monkeypatch):
    """A refused pose until the next one; a prediction out of its bounds until the reset."""
    shown = make(BLADE)
    good, step = shown.moment, shown._live.step
    refused = ValueError('the pose jumps: 9 m/s')
    monkeypatch.setattr(shown._live, 'step', lambda pose: (_ for _ in ()).throw(refused))
    assert shown.advance()._replace(lamp=OK, reason='') == good
    assert shown.moment.reason.startswith(str(refused))
    monkeypatch.undo()
    assert shown.advance()[0] == 1 and shown.moment.lamp == OK
    good = shown.moment
    bad = RolloutStatus.LEFT_BOUNDS
    monkeypatch.setattr(shown._live, 'step', lambda pose: step(pose)._replace(now=bad))
    shown.advance()
    assert shown.moment.lamp == STOPPED and shown.moment.particles is good.particles
    monkeypatch.undo()
    assert shown.advance().lamp == STOPPED
    shown.reset()
    assert shown.advance().lamp == OK


def test_context_and_start_change_the_wheel():
    shown = make(WHEEL)
    starts, up = shown.model.starts, shown.scene.up_axis
    other = int(np.argmax(starts.context[:, 2]))
    shown.reset(start=other)
    assert shown.context['load'] == pytest.approx(starts.context[other, 2])
    heavy = run(shown, 60)[-1]
    light = {**shown.context, 'load': float(starts.context[:, 2].min())}
    shown.reset(context=light)
    assert shown.context == light and shown.start == other
    assert run(shown, 60)[-1].force[up] < heavy.force[up]  # less soil carries less


def test_what_is_not_there_is_refused_and_nothing_changes(tmp_path):
    shown = make(BLADE)
    with pytest.raises(ValueError, match='no frame yet'):
        shown.rollout_file()
    run(shown, 2)
    with pytest.raises(ValueError, match="no recorded run 'test 99'.*test 0"):
        shown.reset('test 99')
    assert shown.moment.frame == 2
    with pytest.raises(ValueError, match='is of the scene wheel'):
        recorded.RecordedRuns(model(BLADE), lts.Dataset('wheel'))
    with pytest.raises(FileNotFoundError, match='no folder with a metadata.json'):
        recorded.of_model(model(BLADE), str(tmp_path))
