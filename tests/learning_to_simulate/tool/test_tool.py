"""What holds for path and outline of every tool, a blade's and a wheel's."""

import numpy as np
import pytest

from learning_to_simulate.tool.swept import Bed, SweptGrid
from tests.learning_to_simulate.swept_field import small_wheel, small_world

RATES = 'speed', 'rise', 'turn', 'rim'


@pytest.fixture(params=[small_world, small_wheel], ids=['blade', 'wheel'])
def world(request):
    return request.param


def parts(world):
    """Tool, size [1, S] and path [T, 1, K] of a world."""
    if world is small_world:
        return world.BLADE, np.array([[world.BLADE.width]]), world.path()
    return world.WHEEL, world.SIZE[None], world.path()


def run(world, plane, bed=None, dt=small_world.DT, state=None):
    """State and last frame of a path; goes on from a state where there is one."""
    tool, size, _ = parts(world)
    size = np.repeat(size, plane.shape[1], axis=0)
    bed = world.flat_bed(plane[0, 0, 0]) if bed is None else bed
    frame = None
    if state is None:
        state, frame = tool.begin(world.GRID, bed, size, plane[0])
        plane = plane[1:]
    for pose in plane:
        state, _, frame = tool.step(world.GRID, bed, size, state, pose, dt)
    return state, frame


def test_two_calls_equal_one(world):
    plane = world.path()
    bed = world.flat_bed(plane[0, 0, 0])
    half, _ = run(world, plane[:30], bed)
    whole, rest = run(world, plane, bed)[1], run(world, plane[30:], bed, state=half)[1]
    for one, other in zip(whole, rest):
        np.testing.assert_array_equal(one, other)


def test_shifting_the_scene_changes_nothing(world):
    plane, bed = world.path(), world.flat_bed(world.path()[0, 0, 0])
    shift = np.zeros(plane.shape[-1])
    shift[:2] = 7.25, -1.5
    moved = Bed(bed.surface - 1.5, bed.level - 1.5, bed.end + 7.25)
    here, there = run(world, plane)[1], run(world, plane + shift, moved)[1]
    np.testing.assert_allclose(there.bins, here.bins, atol=1e-5)
    np.testing.assert_allclose(there.scalars, here.scalars, atol=1e-4, rtol=1e-5)


@pytest.mark.parametrize('factor', [2, 4])
def test_the_frame_rate_hardly_matters(world, factor):
    """Twice and four times the frames of one smooth path."""
    tool = parts(world)[0]
    here = run(world, world.path())[1]
    dt = world.DT / factor
    there = run(world, world.path(60 * factor + 1, dt=dt), dt=dt)[1]
    for name, one, other in zip(tool.scalars, here.scalars[0], there.scalars[0]):
        if name in RATES:  # those of the last frame, half a frame ago
            assert abs(one - other) < 0.05
        else:
            assert other == pytest.approx(one, rel=0.03, abs=0.01), name
    for name, one, other in zip(tool.channels, *np.moveaxis([here.bins[0], there.bins[0]], 2, 1)):
        # A bin more or less is reached at the ends of the way.
        apart = np.sqrt(((other - one) ** 2).mean())
        assert apart <= 0.06 * max(np.sqrt((one**2).mean()), 1e-9), name


def test_tools_of_a_batch_know_nothing_of_each_other(world):
    one = world.path()
    other = one + np.where(np.arange(one.shape[-1]) == 1, -0.004, 0.0)
    beds = [world.flat_bed(one[0, 0, 0])] * 2
    bed = Bed(*map(np.concatenate, zip(*beds)))
    _, both = run(world, np.concatenate([one, other], axis=1), bed)
    for i, alone in enumerate((one, other)):
        for batched, single in zip(both, run(world, alone)[1]):
            np.testing.assert_array_equal(batched[i], single[0])


@pytest.mark.parametrize(
    'change, dt, message',
    [
        (lambda p: p + np.eye(p.shape[1])[0], 0.1, 'do not hold it: begin anew'),
        (lambda p: p * np.nan, 0.1, 'not finite'),
        (lambda p: p[:, :2], 0.1, 'shape'),
        (lambda p: p, 0.0, 'time does not go back'),
        (lambda p: p, -0.1, 'time does not go back'),
    ],
)
def test_bad_poses_are_refused_and_the_state_stays(world, change, dt, message):
    plane = world.path()
    bed = world.flat_bed(plane[0, 0, 0])
    state, _ = run(world, plane[:10], bed)
    with pytest.raises(ValueError, match=message):
        run(world, change(plane[10])[None], bed, dt, state)
    for one, other in zip(run(world, plane[10:20], bed, state=state)[1], run(world, plane[:20])[1]):
        np.testing.assert_array_equal(one, other)


def outline(world, pose, n=4000):
    """[n, 2] points of the tool's outline, drawn from its definition: a stadium or a circle."""
    angle, share = np.linspace(0, 2 * np.pi, n), np.linspace(0, 1, n)[:, None]
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if world is small_wheel:
        return pose[:2] + world.RADIUS * ring
    tool = world.BLADE
    axis = tool.length * np.array([-np.sin(pose[2]), np.cos(pose[2])])
    side = tool.radius / tool.length * np.array([axis[1], -axis[0]])
    ring, outward = tool.radius * ring, ring @ axis < 0
    ends = ring[outward], axis + ring[~outward]
    return pose[:2] + np.concatenate([share * axis + side, share * axis - side, *ends])


def test_points_in_a_tool_leave_by_the_shortest_way(world):
    tool, size, plane = parts(world)
    pose, size, drawn = plane[30, 0], size[0], outline(world, plane[30, 0])
    half = tool.width_of(size) / 2
    box = [[*(drawn.min(axis=0) - 0.02), -1.2 * half], [*(drawn.max(axis=0) + 0.02), 1.2 * half]]
    points = np.random.default_rng(0).uniform(*box, (3000, 3))
    depth, way = tool.inside(points, pose, size)
    is_in = depth > 0
    assert 200 < is_in.sum() < 2800
    for point, d in zip(points[is_in][:200], depth[is_in]):
        to_outline = np.hypot(*(drawn - point[:2]).T).min()
        assert d == pytest.approx(min(to_outline, half - abs(point[2])), abs=3e-4)
    np.testing.assert_allclose(np.linalg.norm(way, axis=1), depth, atol=1e-12)
    assert tool.inside(points + way, pose, size)[0].max() < 1e-12
    # No nearest side: out to the front of a blade, down from an axle.
    (way,) = tool.inside(np.array([[*pose[:2], 0.0]]), pose, size)[1]
    if half > tool.inside([[*pose[:2], 0.0]], pose, size)[0][0]:
        front = [np.cos(pose[2]), np.sin(pose[2])] if world is small_world else [0.0, -1.0]
        np.testing.assert_allclose(way[:2] / np.hypot(*way[:2]), front, atol=1e-12)


@pytest.mark.parametrize(
    'values, message',
    [({'radius': 0.0}, 'radius must be positive'), ({'radius': 0.001}, 'falls between bins')],
)
def test_bins_that_a_circle_falls_between_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        SweptGrid(**values)
