"""The soil field in C against its twin in Python: all functions, whole paths, words, refusals."""

import ctypes
import dataclasses
import functools
import types

import numpy as np
import pytest

from learning_to_simulate.live.poses import turned
from learning_to_simulate.native import library, soil_data, soil_engine
from learning_to_simulate.native.binding import KERNELS, Loaded
from learning_to_simulate.soil_field import sweep
from learning_to_simulate.soil_field.field import CONDITIONS
from learning_to_simulate.soil_field.stepper import SoilStepper
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import STANDARD_DENSITY, Blade, Soil, Wheel
from tests.learning_to_simulate.native import worlds
from tests.learning_to_simulate.soil_field.scenes import hills, poses

pytestmark = worlds.needs_c
BLADE = Blade(0.3, bucket=1.0, floor_deg=9.0, floor_share=0.55)
WHEEL = Wheel(0.1, 0.08, 12, 0.008)
PLATE = dataclasses.replace(BLADE, bucket=0.0, plates=0.0)
TOOLS = {'blade': BLADE, 'wheel': WHEEL}
ONE_AND_ANOTHER = pytest.mark.parametrize(
    'tool, ground', [(BLADE, 'hills'), (WHEEL, 'flat')], ids=TOOLS
)
THE_OTHER_TWO = pytest.mark.parametrize(
    'tool, ground', [(BLADE, 'flat'), (WHEEL, 'hills')], ids=TOOLS
)
DT = 0.1


@functools.cache
def field(name='blade'):
    """See `worlds.soil_field`; not to be changed."""
    return worlds.soil_field(name)


def ranged(name='blade', **ranges):
    """The same with other ranges."""
    made = field(name)
    return type(made)(made.config, made.networks, made.ranges | ranges)


def flat(height=0.0, **more):
    return Terrain.flat((4.0, 2.4), height, corner=(-2.6, -1.2), floor=height - 0.6, **more)


def both(terrain, tool=BLADE, made=None, **more):
    """Steppers by C and by TensorFlow, each on a terrain of its own."""
    made = made or field(tool.name)
    return [
        SoilStepper(made, ground, tool, engine=engine, **more)
        for ground, engine in ((terrain, 'c'), (terrain.clone(), 'tensorflow'))
    ]


def path(count=60, end=0.9, depth=0.04, start=0.0):
    """Down, along, and up a bit [T, 3]: u, height of the edge and lean."""
    t = np.linspace(0.0, 1.0, count)
    dip = np.clip(np.minimum(t / 0.2, (1.05 - t) / 0.2), 0.0, 1.0)
    return np.stack(
        [start + end * t, 0.03 - (depth + 0.03) * dip, 0.2 + 0.1 * np.sin(9 * t)], axis=1
    )


def assert_frame(c, tf):
    size = max(np.abs(tf.force).max(), 1e-3)
    for name in ('force', 'torque', 'spread'):
        np.testing.assert_allclose(getattr(c, name), getattr(tf, name), atol=2e-5 * size)
    np.testing.assert_allclose(c.bound, tf.bound, atol=2e-5 * size)
    np.testing.assert_allclose(c.pose, tf.pose, rtol=1e-15)
    np.testing.assert_allclose(c.payload, tf.payload, atol=1e-9)
    assert c.now == tf.now and c.judgement == tf.judgement
    assert c.status == tf.status and c.reason == tf.reason


def assert_ground(c, tf):
    np.testing.assert_allclose(c.terrain.heights, tf.terrain.heights, atol=2e-7)
    assert np.ptp(tf.terrain.heights) > 1e-3


def step(pair, pose, dt=DT):
    """The next frame of both, held against each other."""
    frames = [one.step(pose, dt) for one in pair]
    assert_frame(*frames)
    return frames


def drive(pair, way, dt=DT, **more):
    """Both along a way, frame by frame; their last frames."""
    c, tf = pair
    way = poses(way, **more) if way.shape[1] == 3 else way
    if tf._frame is None:
        assert_frame(c.start(way[0]), tf.start(way[0]))
        way = way[1:]
    felt = 0
    for pose in way:
        frames = step(pair, pose, dt)
        felt += bool(frames[1].force.any())
    assert felt
    return frames


def test_the_bound_of_the_force_is_that_of_all_members():
    made = dataclasses.replace(field(), bounds={'force': [3.0, 1.5, 0.25], 'near_mm': 2.0})
    wide = dataclasses.replace(BLADE, width=1.2)  # a scaled scene: 8 N to one of the field
    frame = drive(both(flat(), wide, made), path(30, 0.4))[0]
    assert wide.scale == 2 and frame.force.any()
    lengths = np.linalg.norm(frame.spread[:3]), np.linalg.norm(frame.force)
    assert frame.bound == pytest.approx(3.0 * 8 + 1.5 * lengths[0] + 0.25 * lengths[1])
    c, tf = drive(both(flat(), wide, made, members=1), path(30, 0.4))
    assert np.isnan(c.bound) and np.isnan(tf.bound)


def test_a_blade_on_its_head_is_flagged_where_it_reaches_the_soil():
    made = ranged(lean=[-1.0, 1.0])
    for height, status in ((BLADE.length + 0.3, 'ok'), (BLADE.length - 0.05, 'extrapolating')):
        for tool in both(flat(), made=made):
            frame = tool.start(poses([[0.0, height, np.pi]])[0])
            assert frame.status == status and ('lean 3.14' in frame.reason) == (status != 'ok')


def test_frames_as_the_networks_see_them_and_what_these_say():
    made = field()
    for terrain, n_strip in ((flat(), 1), (hills(), 11)):
        c, tf = both(terrain)
        drive((c, tf), path(30, 0.4))
        passage = tf._engine._passage
        bins = np.empty((n_strip, 261, len(sweep.CHANNELS)), np.float32)
        scalars = np.empty((n_strip, passage.frame.scalars.shape[-1]), np.float32)
        assert c._engine.call('see', bins, scalars) == n_strip
        np.testing.assert_allclose(bins, passage.frame.bins[0], atol=1e-6)
        np.testing.assert_allclose(scalars, passage.frame.scalars[0], atol=1e-6)
        loads = np.empty((3, 6), np.float32)
        c._engine.call('loads', loads)
        wanted = made.loads(passage.frame)[:, 0]
        np.testing.assert_allclose(loads, wanted, atol=1e-5 * np.abs(wanted).max())
        rng = np.random.default_rng(1)
        places = rng.uniform([-0.5, -0.5], [0.6, 0.5], (500, 2))
        risen = np.empty(len(places), np.float32)
        c._engine.call('rise', places, len(places), risen)
        wanted = made.rise(passage, places)
        assert 0.1 < np.mean(wanted == 0) < 0.9
        np.testing.assert_allclose(risen, wanted, atol=1e-6)
        assert np.mean((risen == 0) == (wanted == 0)) > 0.99  # at the edge by round-off
        np.testing.assert_allclose(c.place[:3], tf.place[:3], atol=1e-15)


GROUNDS = {'flat': flat, 'hills': hills}


@ONE_AND_ANOTHER
def test_a_long_way_there_and_back(tool, ground):
    yaw = 0.7
    way = path(70, 1.5)
    way = np.concatenate([way, way[::-1]])
    way[:, 1] += tool.radius
    way[:, 2] *= np.linspace(1.0, -20.0, len(way)) if tool is WHEEL else 1.0
    pair = both(GROUNDS[ground](), tool)
    drive(pair, way, yaw=yaw)
    assert_ground(*pair)
    # Lifted, turned, set down beside the cut, and on to uneven ground.
    air = poses([[0.1, 0.9, 0.1]], yaw=yaw)[0]
    for pose in (air, poses([[0.15, 0.95, 0.1]], yaw=yaw + 0.5, shift=(0.0, 0.0, 0.2))[0]):
        frames = step(pair, pose, 0.4)
        assert not frames[0].force.any()
    assert pair[0].place.along == pytest.approx(pair[1].place.along, abs=1e-12)
    beside = path(50, 0.6) + [0.1, tool.radius, 0.0]
    drive(pair, beside, yaw=yaw + 0.5, shift=(0.0, 0.0, 0.2), dt=0.5)
    assert_ground(*pair)


def test_even_ground_that_ends_takes_all_strips():
    terrain = flat()
    terrain.heights[:60, 70:] += 0.05  # from x = -1.4 on, beside the way
    pair = both(terrain)
    drive(pair, path(60, 0.4))
    assert len(pair[1]._engine._passage.strips.centres) == 1
    drive(pair, path(90, 1.2, start=0.4)[20:])
    assert len(pair[1]._engine._passage.strips.centres) == 11
    assert_ground(*pair)


def test_several_tools_on_one_terrain_each_meet_what_the_others_left():
    """Two side by side and one across, in turn: as in Python, also where one of them is in it."""
    ways = [
        poses(path(50, 0.9)), poses(path(50, 0.9), shift=(0.0, 0.0, 0.28)),
        poses(path(50, 1.0), yaw=1.4, shift=(-0.3, 0.0, 0.5)),
    ]  # fmt: skip
    results = []
    for kinds in (('c', 'tensorflow', 'c'), ('tensorflow',) * 3):
        terrain = hills(size=(2.4, 2.4))
        tools = [SoilStepper(field(), terrain, BLADE, engine=kind) for kind in kinds]
        frames = [[tool.start(way[0]) for tool, way in zip(tools, ways, strict=True)]]
        for t in range(1, 50):
            frames.append([tool.step(way[t], DT) for tool, way in zip(tools, ways, strict=True)])
        heights = terrain.heights.copy()
        np.testing.assert_array_equal(terrain.heights, heights)  # looking changes nothing
        results.append(([np.concatenate([f.force for f in row]) for row in frames], heights))
    (force, heights), (wanted, ground) = results
    np.testing.assert_allclose(force, wanted, atol=2e-5 * np.abs(wanted).max())
    np.testing.assert_allclose(heights, ground, atol=1e-6)


def test_other_soils_sizes_members_and_walls():
    soil = Soil(31.0, 1500.0, 1.62)
    for tool in (Blade(1.2, 0.03, 0.6), Blade(0.1, 0.005, 0.2), Wheel(0.3, 0.3)):
        s = tool.scale
        terrain = Terrain(hills().heights[::2] * s, [0.04 * s, 0.02 * s], [-1.1 * s, -0.6 * s],
                          soil, walled=True)  # fmt: skip
        pair = both(terrain, tool, members=2)
        way = path(25, 0.5) * [s, s, 1.0]
        way[:, 1] += tool.radius
        drive(pair, way, dt=0.1)
        assert_ground(*pair)


def test_a_step_may_take_long():
    """What is slow resembles training: of speeds only the largest is a limit."""
    pair = both(flat(), made=ranged(speed=[0.0, 0.5]))
    way = poses(path(30, 0.4))
    drive(pair, way[:20])
    quick = pair[1].propose(way[20], DT)
    slow = step(pair, way[20], 1000.0)[0]
    assert 'speed' not in slow.reason and np.isfinite(slow.force).all() and slow.force.any()
    assert not np.array_equal(slow.force, quick.force)  # the speed is an input
    assert_ground(*pair)


def test_the_floor_below_a_wheel():
    ground = [Terrain.flat((4.0, 2.4), corner=(-2.6, -1.2), floor=floor) for floor in (-0.12, -1.0)]
    way = path(30, 0.3) + [0.0, WHEEL.radius, 0.0]
    thin, thick = (drive(both(soil, WHEEL), way)[0] for soil in ground)
    assert not np.allclose(thin.force, thick.force, rtol=1e-3)


def test_every_kernel_gives_the_same():
    wanted = both(hills())[1]
    way = poses(path(25, 0.4))
    wanted.start(way[0])
    for pose in way[1:]:
        last = wanted.step(pose, DT)
    for kernel in KERNELS:
        terrain = hills()
        try:
            loaded = Loaded.of(soil_data.values(field()), kernel)
            c = soil_engine.CEngine(loaded, terrain, BLADE)
        except ValueError:
            continue
        assert kernel in c.name
        c.start(way[0])
        for pose in way[1:]:
            frame = c.step(pose, DT)
        assert_frame(frame, last)
        c.update()
        np.testing.assert_allclose(terrain.heights, wanted.terrain.heights, atol=2e-7)


@pytest.mark.parametrize('ground', [flat, hills])
def test_particles(ground):
    pair = c, tf = both(ground())
    drive(pair, path(20, 0.1))
    first = tf.particles()
    np.testing.assert_allclose(c.particles(), first, atol=1e-6)
    way = poses(path(70, 0.8, start=0.1)[15:])
    for pose in way:
        for one in pair:
            one.step(pose, DT)
    points = tf.particles()
    np.testing.assert_allclose(c.particles(), points, atol=2e-6)
    assert len(points) > 2000
    np.testing.assert_array_equal(c.clone().particles(), c.particles())
    ends = []
    for one in pair:  # given ones, from before the tool is set down
        anchor = one._engine.anchor(way[0], set_down=True)
        anchor.follow(way[3], DT)
        ends.append(anchor.displaced(first.astype(float)))
    np.testing.assert_allclose(*ends, atol=2e-6)
    assert np.abs(ends[0] - first).max() > 1e-4
    # Also beyond the bins in one step.
    for one in pair:
        one.step(poses([[1.3, 0.0, 0.1]])[0], dt=0.5)
    np.testing.assert_allclose(c.particles(), tf.particles(), atol=2e-6)


def bytes_of(stepper):
    """The saved state of an instance in C."""
    saved = np.empty(stepper._engine.call('state_size'), np.uint8)
    stepper._engine.call('save', saved, saved.nbytes)
    return saved


def test_a_proposal_is_the_next_frame_and_changes_nothing():
    """Also where the next step renews the passage, and far from where the tool is."""
    pair = both(hills())
    way = poses(path(60, 0.9))
    assert_frame(*(one.start(way[0]) for one in pair))
    renewed = 0
    for t, pose in enumerate(way[1:]):
        passage, before = pair[1]._engine._passage, [one.terrain.heights.copy() for one in pair]
        is_due, more = passage.is_due, [(pose, DT)]
        if t == 40:
            more += [(other, 1.0) for other in way[40:60:3]]
            more.append((poses([[0.4, 0.4, 0.0]], yaw=0.2)[0], 0.5))
        if is_due:  # a jump does not renew it
            saved, far = bytes_of(pair[0]), pose - [1.2, 0, 0, 0, 0, 0, 0]
            assert 'within one frame' in refused(pair, lambda one, far=far: one.step(far, 1.0))
            np.testing.assert_array_equal(bytes_of(pair[0]), saved)
        for there, dt in more:
            seen = [one.propose(there, dt) for one in pair]
            assert_frame(*seen)
            for one, frame in zip(pair, seen):
                wanted = np.append(frame.force, frame.torque)
                np.testing.assert_array_equal(one._engine.load(there, dt), wanted)
        for one, heights in zip(pair, before):
            np.testing.assert_array_equal(one.terrain.heights, heights)
        assert pair[1]._engine._passage is passage
        seen = [one.propose(pose, DT) for one in pair]
        for frame, proposed, atol in zip(step(pair, pose), seen, (1e-9 * is_due, 1e-9)):
            np.testing.assert_allclose(frame.force, proposed.force, rtol=0, atol=atol)
        renewed += is_due
        assert (pair[1]._engine._passage.state.way < passage.state.way) == is_due
    assert renewed
    assert_ground(*pair)


def test_clones_go_on_to_the_same_bits():
    pair = both(hills())
    way = poses(path(60, 0.9))
    drive(pair, way[:40])
    for one in pair:
        copied = one.clone()
        assert copied.terrain is not one.terrain and copied.engine == one.engine
        for pose in way[40:50]:
            np.testing.assert_array_equal(copied.step(pose, DT).force, one.step(pose, DT).force)
        np.testing.assert_array_equal(copied.terrain.heights, one.terrain.heights)


def test_stiffness_is_the_difference_of_proposals_and_changes_nothing():
    pair, reach = both(hills()), 1e-3
    frames = drive(pair, path(20, 0.5), yaw=0.3)
    along, across = pair[0].place[1:3]
    ways = [[*along, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 0, *across], [0.3, 0.2, -1, 0.5, 2, 1]]
    stiff = []
    for one, last in zip(pair, frames):
        for way in np.array(ways):
            step = reach / (np.linalg.norm(way[:3]) + 0.1 * np.linalg.norm(way[3:]))
            ends = [
                one.propose(
                    np.append(last.pose[:3] + by * way[:3], turned(last.pose[3:], by * way[3:])), DT
                )
                for by in (step, -step)
            ]
            up, down = (np.append(frame.force, frame.torque) for frame in ends)
            found = one._engine.tangent(way, DT, reach)
            np.testing.assert_allclose(found, (up - down) / (2 * step), rtol=1e-6, atol=1e-3)
            stiff.append(found)
        np.testing.assert_allclose(one.stiffness(DT, reach).T, stiff[-4:-1])
        assert one.frame is last
    np.testing.assert_allclose(*np.split(np.array(stiff), 2), atol=1e-3 * np.abs(stiff).max())
    assert np.abs(stiff).max() > 100
    with pytest.raises(ValueError):
        pair[0]._engine.tangent(np.zeros(6), DT, reach)


def test_bytes_of_an_instance_go_on_to_the_same_bits():
    for ground in (flat(), hills()):
        c, _ = both(ground)
        way = poses(path(60, 0.9))
        other = SoilStepper(c.field, ground.clone(), BLADE, engine='c')
        one, two = c._engine, other._engine
        saved = bytes_of(c)
        c.start(way[0])
        two.call('restore', saved, saved.nbytes)  # of one that stands nowhere
        with pytest.raises(ValueError):
            two.call('newest', np.empty(60))
        for pose in way[1:30]:
            c.step(pose, DT)
        small, saved = saved, bytes_of(c)
        assert saved.nbytes > small.nbytes + 8000
        heights = ground.seen.copy()
        frames = [c.step(pose, DT) for pose in way[30:]]
        for bad in (small[:50], saved[:-1], np.where(np.arange(saved.size) == 3000, 1, saved)):
            with pytest.raises(ValueError):
                two.call('restore', np.ascontiguousarray(bad, np.uint8), len(bad))
        with pytest.raises(ValueError):
            one.call('save', saved, one.call('state_size') - 1)
        for engine in (one, two):
            engine.terrain._heights[:] = heights
            engine.call('restore', saved, saved.nbytes)
            for pose, frame in zip(way[30:], frames, strict=True):
                again = engine.step(pose, DT)
                np.testing.assert_array_equal(again.force, frame.force)
                assert again.judgement == frame.judgement
        two.update()
        np.testing.assert_array_equal(other.terrain.seen, c.terrain.heights)


def test_a_tool_faster_than_any_taught_feels_what_the_fastest_did():
    way, forces = path(15, 0.2), []
    for most in (0.02, 9.0):
        frame, _ = drive(both(flat(), made=ranged(speed=[0.0, most])), way)
        assert frame.reason.startswith('speed ') == (most < 1)
        forces.append(frame.force)
    assert np.abs(np.subtract(*forces)).max() > 1e-3


@pytest.mark.parametrize('tool', TOOLS.values(), ids=TOOLS)
@pytest.mark.parametrize('name', ['friction', 'stress'])
def test_a_soil_far_from_all_taught_acts_as_a_nearer_one(name, tool):
    soils = {
        'friction': [Soil(np.degrees(np.arctan(k))) for k in (0.8, 0.9, 4.0)],
        'stress': [
            Soil(density=np.exp(k) * STANDARD_DENSITY / tool.scale) for k in (0.5, 0.75, 3.0)
        ],
    }[name]
    limits, way, seen = {'friction': [0.6, 0.8], 'stress': [0.0, 0.5]}, path(15, 0.2), []
    for soil in soils:
        pair = both(flat(soil=soil), tool, ranged(tool.name, **{name: limits[name]}))
        frame, _ = drive(pair, way)
        assert frame.reason.startswith(name) == (soil is not soils[0])
        seen.append((frame.force / tool.units(soil)[:3], pair[0].terrain.heights))
    for _, farthest, beyond in zip(*seen):
        np.testing.assert_allclose(beyond, farthest, rtol=1e-4, atol=1e-6)
    assert not np.allclose(seen[0][0], seen[1][0], rtol=1e-4)


def scoop():
    """A cut, up and curled, some way aside in the air, and back in steps [T, 7]."""
    dig = path(30, 0.4)[:-5]
    u, y, lean = dig[-1]
    up = np.linspace([u, y, lean], [u + 0.05, 0.3, 0.7], 15)[1:]
    aside = poses(np.repeat(up[-1:], 12, axis=0))
    aside[:, 2] += np.linspace(0.0, 0.4, 12)
    back = poses(np.linspace(up[-1], [u + 0.05, 0.3, -0.4], 15)[1:])
    back[:, 2] += 0.4
    return np.concatenate([poses(np.concatenate([dig, up])), aside, back])


def volume(one):
    """m3 over a height of 0, with what the bucket holds."""
    cell = np.prod(one.terrain.cell)
    assert one.heights.sum() * cell == pytest.approx(
        one.terrain.heights.sum() * cell + one.frame.payload, abs=1e-12
    )
    return one.heights.sum() * cell


@pytest.mark.parametrize('ground', ['flat', 'hills'])
def test_a_bucket_holds_what_it_lifts_and_pours_it_elsewhere(ground):
    pair, held = both(GROUNDS[ground]()), []
    weight = pair[0].terrain.soil.density * pair[0].terrain.soil.gravity
    for one in pair:
        one.start(scoop()[0])
    for pose in scoop()[1:]:
        kept = [one.terrain.heights.copy() for one in pair]
        before = [volume(one) for one in pair]
        trials = [one.propose(pose, DT) for one in pair]
        for one, heights in zip(pair, kept):
            np.testing.assert_array_equal(one.terrain.heights, heights)
        was = held[-1] if held else 0.0
        frames = step(pair, pose)
        held.append(frames[0].payload)
        for trial, frame in zip(trials, frames):
            np.testing.assert_allclose(trial.force, frame.force, atol=1e-9)
        if held[-1] != was or held[-1] > 0:
            for one, there in zip(pair, before):
                assert volume(one) == pytest.approx(there, abs=1e-12)
    assert_ground(*pair)
    most = int(np.argmax(held))
    assert held[most] > 1e-4 and held[-1] == 0 and len(set(held[most:])) > 3
    middle = len(scoop()) - 15  # over fresh ground, still curled
    other = both(GROUNDS[ground]())
    frame = drive(other, scoop()[: middle + 1])[0]
    np.testing.assert_allclose(frame.force, [0.0, -weight * frame.payload, 0.0], rtol=1e-12)
    assert frame.torque @ pair[0].place.across > 0 and frame.payload == held[middle - 1]
    clones = [one.clone() for one in other]
    for pose in scoop()[middle + 1 :]:
        step(other, pose)
        frames = step(clones, pose)
    for one, clone in zip(other, clones):
        np.testing.assert_array_equal(one.terrain.heights, clone.terrain.heights)


def test_a_bucket_that_is_set_down_elsewhere_leaves_what_it_holds():
    pair = both(flat())
    frame = drive(pair, scoop()[:-15])[0]
    before = [volume(one) for one in pair]
    assert frame.payload > 1e-4
    far = poses([[-0.6, 0.3, 0.7]])[0]
    assert_frame(*(one.start(far) for one in pair))
    for one, there in zip(pair, before):
        assert one.frame.payload == 0 and volume(one) == pytest.approx(there, abs=1e-12)
    assert_ground(*pair)
    assert not drive(both(flat(), PLATE), scoop()[:-15])[0].payload


def test_a_bucket_that_rolls_or_turns_over_with_soil_in_it_is_flagged():
    made, roll = ranged(lean=[-1.0, 1.0]), np.radians(5.0)
    for way, reason in ((scoop()[:-15], 'roll'), (scoop()[:1] + np.eye(7)[1], '')):
        pair = both(flat(), made=made)
        for one in pair:
            one.start(way[0])
        for pose in way[1:]:
            step(pair, pose)
        rolled = np.append(way[-1][:3], turned(way[-1][3:], roll * pair[0].place.along))
        assert step(pair, rolled)[0].now.reason[:4] == reason
        over = poses([[0.45, 0.7, 1.3]])[0]
        over[:3] = way[-1][:3]
        assert step(pair, over)[0].now.reason[:4] == reason.replace('roll', 'lean')


def test_a_bucket_that_presses_with_its_heel_is_flagged():
    made, dig = ranged(lean=[-1.0, 1.0], pressed=[0.0, 1.0]), path(30, 0.3)[:-8] * [1, 1, 0]
    u, y, _ = dig[-1]
    for rise, reason in ((0.0, 'heel'), (0.15, '')):  # at its depth; about a pin over its edge
        on = np.linspace(0.0, 1.0, 15)[1:, None]
        curl = dig[-1] + on * [0.2, 0.0, 0.4] + np.sin(on * 0.4) * [0.0, rise, 0.0]
        pair = both(flat(), made=made)
        found = drive(pair, np.concatenate([dig, curl[:9]]))[0].now.reason
        assert found[:4] == reason


@THE_OTHER_TWO
def test_a_tool_that_is_clear_of_its_heap_is_in_the_air(tool, ground):
    pair = both(GROUNDS[ground](), tool)
    (_, last), ends, kappa = drive(pair, path(30, 0.3)), [], 0.0
    for height in np.linspace(last.pose[1], 0.02 + 1.6 * tool.radius + 0.13, 15):
        pose = np.array(last.pose)
        pose[1] = height
        frames = step(pair, pose)
        # A bucket feels what it holds even there.
        weight = frames[0].payload * pair[0].terrain.soil.density * pair[0].terrain.soil.gravity
        ends.append(np.linalg.norm(frames[0].force + [0.0, weight, 0.0]).round(9))
        passage = pair[1]._engine._passage
        if not ends[-1]:  # as far as it knows what was cut, a heap might reach it
            kappa += pair[1].field.networks.inputs.load_inputs(*passage.frame)[2].numpy().max()
    assert ends[0] > 0 == ends[-1] and kappa > 0
    pose[2] += 0.05
    frames = step(pair, pose)
    assert frames[0].now.status == 'ok' and pair[1]._engine._passage is not passage


@ONE_AND_ANOTHER
def test_a_lifted_tool_leaves_its_cut_and_begins_anew(tool, ground):
    pair, high = both(GROUNDS[ground](), tool), 0.3 + 2 * tool.radius
    drive(pair, path(30, 0.4))
    for one in pair:
        one.particles()
    u, y, lean = path(30, 0.4)[-1]
    for height in np.linspace(y, high, 12):
        pose = poses([[u, height, lean]])[0]
        step(pair, pose)
        assert_ground(*pair)
    heights, passage = pair[0].terrain.heights.copy(), pair[1]._engine._passage
    assert passage.is_lifted and not passage.is_over and passage.state.way < 0.5
    for x in (0.6, 0.7, 0.5):
        pose = poses([[x, high, lean]])[0]
        step(pair, pose)
    np.testing.assert_array_equal(pair[0].terrain.heights, heights)
    drive(pair, np.append([[0.5, 0.2, 0.2]], path(30, -0.4, start=0.5), axis=0))
    assert_ground(*pair)
    for one in pair:
        assert np.isfinite(one.particles()).all()


def test_a_dam_is_flagged_where_it_bears():
    ground = flat()
    is_dam = np.abs(ground.middles[1]) < 0.2
    ground.write(slice(None), np.where(is_dam, 0.0, -0.5 + np.zeros((200, 1))).ravel())
    frame, _ = drive(both(ground, made=ranged(bed_low=[-0.1, 0.0])), path(30, 0.4))
    assert frame.force.any() and frame.now.status == 'extrapolating'


@pytest.mark.parametrize('tool', TOOLS.values(), ids=TOOLS)
def test_all_numbers_that_are_judged_flag_word_for_word(tool):
    found = [name for name in field(tool.name).judged_names if name not in CONDITIONS]
    for name in found:
        pair = both(hills(), tool, ranged(tool.name, **{name: [50.0, 60.0]}))
        frame, _ = drive(pair, path(10, 0.2))
        assert frame.reason.startswith(f'{name} ') and frame.status == 'extrapolating'
    assert {'lean', 'carried', 'half_width', 'bed_low', 'uneven', 'along', 'backed'} < set(found)


def test_flags_word_for_word():
    for turn, name in (([0, 0.1, 0], 'yaw'), ([0.06, 0, 0], 'roll'), (None, 'aside')):
        pair = both(hills(), PLATE)
        frame, _ = drive(pair, path(15, 0.2))
        pose = np.array(frame.pose)
        if turn is None:
            pose[2] += 0.03
        else:
            pose[3:] = turned(pose[3:], turn)
        frames = step(pair, pose)
        assert frames[0].reason.startswith(f'{name} ')
        # The worst stays, the newest is well again.
        frames = step(pair, frame.pose)
        assert frames[0].now.status == 'ok' and frames[0].status == 'extrapolating'


@pytest.mark.parametrize(
    'name, terrain, shift',
    [
        ('beyond_map', flat(), 1.1),
        ('wall_beside', flat(walled=True), 1.0),
        ('thin_soil', Terrain.flat((4.0, 2.4), corner=(-2.6, -1.2), floor=-0.07), 0.0),
        ('cell', Terrain.flat((4.0, 2.4), corner=(-2.6, -1.2), cell=0.06), 0.0),
    ],
)
def test_places_that_training_did_not_have_are_flagged_word_for_word(name, terrain, shift):
    way = path(15, 0.2)
    frame, _ = drive(both(terrain, PLATE), way, shift=(0.0, 0.0, shift))
    assert frame.reason.startswith(f'{name} 0.0') and frame.status == 'extrapolating'
    frame, _ = drive(both(flat(), PLATE), way)
    assert frame.status == 'ok'
    # High in the air a tool may be anywhere.
    pair, high = both(terrain, PLATE), [[u, 0.5, 0.1] for u in (0.0, 0.05)]
    for pose in poses(high, shift=(0.0, 0.0, shift)):
        for one in pair:
            one.step(pose, DT) if one._frame else one.start(pose)
        assert_frame(*(one.frame for one in pair))
    assert pair[0].frame.status == 'ok'


def test_another_tool_close_by_is_flagged():
    pair = both(flat(), PLATE)
    frame, _ = drive(pair, path(15, 0.2))
    others = [SoilStepper(field(), one.terrain, Blade(0.2), engine=kind)
              for one, kind in zip(pair, ('c', 'tensorflow'))]  # fmt: skip
    for aside, status in ((0.36, 'ok'), (0.34, 'extrapolating')):  # half of both, and 0.1 m
        for other in others:
            other.start(poses([[0.2, 0.4, 0.1]], shift=(0.0, 0.0, aside))[0])
        frames = step(pair, frame.pose)
        assert frames[0].now.status == status
    assert frames[0].reason.startswith('other_tool 0.01 is outside')


def test_what_is_not_finite_is_said():
    made = worlds.soil_field('blade', members=2)
    made.networks.load.layers[-1][1].assign(np.full((2, 1, 5), np.nan))
    c, tf = both(flat(), made=made)
    for one in (c, tf):
        one.start(poses([[0.0, 0.0, 0.1]])[0])
    assert c.frame.judgement == tf.frame.judgement and c.frame.status == 'non_finite'


def refused(pair, call):
    """Both refuse a call with a stepper, in the same words, which are returned."""
    texts = []
    for one in pair:
        with pytest.raises((ValueError, TypeError)) as caught:
            call(one)
        texts.append(str(caught.value))
    assert texts[0] == texts[1], texts
    return texts[0]


def test_refusals_have_the_words_of_python_and_change_nothing():
    c, tf = pair = both(flat())
    assert 'call start' in refused(pair, lambda one: one.step(poses([[0.0, 0.1, 0.0]])[0]))
    drive(pair, path(30, 0.4))
    frame, good = c.frame, np.array(c.frame.pose)
    quarter = np.append(good[:3], turned(good[3:], [0.0, 0.0, 1.5]))
    bad = [
        (good + [2, 0, 0, 0, 0, 0, 0], DT), (quarter, 0.02), (good[:6], DT), (good * np.nan, DT),
        (np.append(good[:3], 2 * good[3:]), DT), (good - [0, 0.9, 0, 0, 0, 0, 0], 1.0), (good, 0.0),
        (good, -1.0), (good, np.nan), (good - [0.5, 0, 0, 0, 0, 0, 0], 1.0), (None, DT), ('x', DT),
    ]  # fmt: skip
    for pose, dt in bad:
        refused(pair, lambda one, given=(pose, dt): one.step(*given))
        refused(pair, lambda one, given=(pose, dt): one.propose(*given))
    on_side = np.append(good[:3], turned(good[3:], [np.pi / 2, 0.0, 0.0]))
    for pose in (good[:6], good * np.nan, good - [0, 0.9, 0, 0, 0, 0, 0], on_side):
        refused(pair, lambda one, pose=pose: one.start(pose))
    assert c.frame is frame
    for one in pair:
        for values in (one.frame.pose, one.frame.force, one.frame.torque, one.frame.spread):
            with pytest.raises(ValueError, match='read-only'):
                values[:] = 0
    for one in pair:  # begins anew: its cut comes to rest and is as it is
        one.start(poses([[0.1, 0.9, 0.0]])[0])
    assert_ground(*pair)
    for one in pair:
        one.start(good)
    drive(pair, path(60, 0.8)[32:])
    c.terrain.heights[:] = np.nan
    with pytest.raises(ValueError, match='not finite'):
        c.start(good)


def test_who_gets_which_engine(monkeypatch):
    assert SoilStepper(field(), flat()).engine.startswith('C (')
    assert SoilStepper(field(), flat(), engine='tensorflow').engine == 'TensorFlow'
    with pytest.raises(ValueError, match='engine is'):
        SoilStepper(field(), flat(), engine='fortran')

    def none():
        raise library.NoCompiler('no C compiler: none')

    monkeypatch.setattr(library, 'load', none)
    assert SoilStepper(field(), flat()).engine == 'TensorFlow (no C compiler: none)'
    with pytest.raises(library.NoCompiler):
        SoilStepper(field(), flat(), engine='c')


def test_a_tool_that_goes_leaves_its_cut_and_the_terrain():
    terrain = flat()
    tool = SoilStepper(field(), terrain, BLADE, engine='c')
    tool.start(poses([[0.0, 0.0, 0.1]])[0])
    for pose in poses(path(20, 0.2))[10:]:
        tool.step(pose, DT)
    ground = soil_engine.ground_of(terrain)
    assert ground.first and not np.ptp(terrain._heights)
    del tool
    assert not ground.first and np.ptp(terrain._heights) > 1e-3


def test_tools_and_terrains_that_cannot_be_are_refused():
    loaded = Loaded.of(soil_data.values(field()))
    good = types.SimpleNamespace(width=0.3, radius=0.01, length=0.2)
    soil_engine.CEngine(loaded, flat(), good)
    for change in ({'width': 0.0}, {'radius': np.nan}, {'length': -1.0}, {'bucket': 0.5}):
        with pytest.raises(ValueError, match='range'):
            bad = types.SimpleNamespace(**(vars(good) | change))
            soil_engine.CEngine(loaded, flat(), bad)
    terrain = flat()
    ground = soil_engine.ground_of(terrain)
    for name, value in (('gravity', 0.0), ('density', np.nan), ('friction_angle_deg', 90.0)):
        kept = getattr(ground, name)
        setattr(ground, name, value)
        with pytest.raises(ValueError, match='range'):
            soil_engine.CEngine(loaded, terrain, good)
        setattr(ground, name, kept)
    assert loaded.c.lts_soil_describe(None, None) == library.constants()['LTS_ERROR_NULL']
    found = library.structures()['lts_soil_description']()
    assert loaded.c.lts_soil_describe(loaded.model, ctypes.addressof(found)) == 0
    assert found.judged_names.decode().split(',') == list(field().judged_names)
