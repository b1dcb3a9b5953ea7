"""The swept field in C against its numpy and TensorFlow twins, kernel by kernel."""

import os

import numpy as np
import pytest

from learning_to_simulate.native import field_data, library, project
from learning_to_simulate.native.binding import KERNELS, CField, KernelLacks
from learning_to_simulate.swept_field import calibration
from learning_to_simulate.swept_field.network import stacked
from learning_to_simulate.tool.bed import HeightMap
from learning_to_simulate.tool.blade import Blade
from learning_to_simulate.tool.inputs import Row, Table
from tests.learning_to_simulate.swept_field import small_world as world

pytestmark = pytest.mark.skipif(
    not any(map(library.shutil.which, ('cc', 'gcc', 'clang'))), reason='no C compiler'
)
BOUND = [1.5, 2.0, 0.1]
MAP = HeightMap(np.array([0.9, 0.1, 0.6, 0.3]), np.array([0.24, 0.26, 0.19, 0.25]))


@pytest.fixture(scope='module')
def field():
    found = world.make_field()
    found.calibration = {'force': BOUND}
    # As of a model folder; places on the edge of two slabs fall to the same side then.
    found.rest = found.rest.astype(np.float32).astype(np.float64)
    return found


def stretched(field, bed):
    """Particles [N, 3] of the flat bed with the heights of a map."""
    points = field.rest.copy()
    order = np.argsort(bed.places)
    wanted = np.interp(points[:, 0], bed.places[order], bed.heights[order])
    floor, top = points[:, 1].min(), points[:, 1].max() + world.SPACING / 2
    points[:, 1] = floor + (points[:, 1] - floor) * (wanted - floor) / (top - floor)
    return points.astype(np.float32).astype(np.float64)


def twin(field, plane, points, dt=world.DT, velocity=None, width=world.BLADE.width):
    """Loads [M, T, 3] and particles [T, N, 3] of a path, whole, by numpy and TensorFlow."""
    size = np.array([width])
    ground = field.ground(plane[0, 0], size, points)
    tool, frames = field.tool, []
    state, _ = tool.begin(field.grid, ground.bed, size[None], plane[:1], velocity)
    for pose in plane[1:]:
        state, _, seen = tool.step(field.grid, ground.bed, size[None], state, pose[None], dt)
        frames.append(seen)
    seen = stacked(frames)
    moved = field.displacement(seen, ground.local).mean(axis=0)
    there = []
    for pose, shift in zip(plane[1:], moved):
        now, out = shift.any(axis=1), ground.places + shift
        out[now] += tool.inside(out[now], pose, size)[1]
        there.append(out)
    return field.loads(seen), np.array(there), seen


def play(soil, poses, dt=None):
    """Loads [T, 6], bounds [T] and particles [T, N, 3] of steps in C."""
    frames, points = [], []
    for pose in poses:
        frames.append(soil.step(pose, dt))
        points.append(soil.particles())
    loads = [np.concatenate([f.force, f.torque]) for f in frames]
    return np.array(loads), np.array([f.bound for f in frames]), np.array(points)


def assert_same(field, of_c, of_twin):
    loads, bounds, points = of_c
    expected, there, _ = of_twin
    force, torque = field.axes.world_loads(expected.mean(axis=0))
    both = np.concatenate([force, torque], axis=1)
    assert np.abs(force).max() > 10 and np.abs(there[-1] - there[0]).max() > 1e-3
    np.testing.assert_allclose(loads, both, atol=1e-5 * np.abs(both).max())
    of_force = expected[..., :2]
    bound = calibration.bound(calibration.spread(of_force), calibration.size(of_force), BOUND)
    np.testing.assert_allclose(bounds, bound, rtol=1e-4)
    np.testing.assert_allclose(field.axes.points(points), there, atol=1e-6)


@pytest.mark.parametrize('kernel', KERNELS)
def test_equals_the_twin_on_a_whole_path(field, kernel):
    plane = world.path()[:, 0]
    try:
        soil = CField.of(field, kernel)
    except KernelLacks as error:
        pytest.skip(str(error))
    assert soil.kernel == kernel
    poses = world.world_pose(plane)
    soil.start(poses[0])
    assert_same(field, play(soil, poses[1:]), twin(field, plane, field.rest))


@pytest.mark.parametrize('dt', [1 / 240, 1 / 13])
def test_steps_of_any_length_on_a_given_bed_with_another_blade(field, dt):
    plane = world.path(n_frame=1 + int(1 / dt), dt=dt)[:, 0]
    poses, width = world.world_pose(plane), 0.3
    velocity = np.array([0.02, -0.01, 0.0, 0.0, 0.0, 0.3])
    points = stretched(field, MAP)
    expected = twin(field, plane, points, dt, field.axes.velocities(velocity)[None], width)
    soil = CField.of(field)
    for bed in (MAP, points):
        soil.start(poses[0], velocity, bed, width)
        assert_same(field, play(soil, poses[1:], dt), expected)


def test_force_alone_and_particles_late_are_the_same_bits(field):
    poses = world.world_pose(world.path()[:, 0])
    soil, silent = CField.of(field), CField.of(field)
    for one in (soil, silent):
        one.start(poses[0])
    loads, _, points = play(soil, poses[1:])
    alone = np.array([np.concatenate(silent.step(pose)[:2]) for pose in poses[1:]])
    np.testing.assert_array_equal(alone, loads)
    np.testing.assert_array_equal(silent.particles(), points[-1])
    resting = len(field.rest) - soil.moving()
    kept = (points[-1] == field.rest.astype(np.float32)).all(axis=1)
    assert 0 < resting <= kept.sum() < len(field.rest)


def test_fewer_members_answer_as_their_mean(field):
    plane = world.path()[:, 0]
    poses = world.world_pose(plane)
    soil = CField.of(field, members=1)
    soil.start(poses[0])
    loads, _, _ = play(soil, poses[1:])
    first, _, _ = twin(field, plane, field.rest)
    np.testing.assert_allclose(loads[:, :3], field.axes.world_loads(first[0])[0], atol=1e-3)
    with pytest.raises(ValueError, match='members'):
        CField.of(field, members=4)


@pytest.mark.parametrize('bed', [None, MAP], ids=['flat', 'given'])
def test_states_come_back_bit_by_bit(field, bed):
    poses = world.world_pose(world.path()[:, 0])
    soil, other = CField.of(field), CField.of(field)
    soil.start(poses[0], bed=bed)
    play(soil, poses[1:20])
    saved = soil.save()
    first = play(soil, poses[20:40])
    for one in (soil, other):
        one.load_state(saved)
        for a, b in zip(first, play(one, poses[20:40])):
            np.testing.assert_array_equal(a, b)
    soil.load_state(saved)
    other.copy_state(soil)
    np.testing.assert_array_equal(play(other, poses[20:40])[2], first[2])
    for damaged in (saved[:-1], b'', saved[:200] + b'x' + saved[201:]):
        with pytest.raises(ValueError, match='damaged'):
            soil.load_state(damaged)
    assert soil.save() == saved


def test_a_renewed_run_starts_on_the_bed_that_it_left(field):
    poses = world.world_pose(world.path()[:, 0])
    soil, fresh = CField.of(field), CField.of(field)
    soil.start(poses[0])
    play(soil, poses[1:30])
    points = soil.particles()
    rate = np.diff(field.axes.poses(poses[28:30]), axis=0)[0] / world.DT
    turn = field.axes.velocities([0, 0, 0, 0, 0, 1])[2] * rate[2]
    forward, up = field.axes.world([rate[0], rate[1], 0.0])[:2]
    fresh.start(poses[29], [forward, up, 0.0, 0.0, 0.0, turn], points)
    soil.renew()
    for one, two in zip(play(soil, poses[30:40]), play(fresh, poses[30:40])):
        np.testing.assert_allclose(one, two, rtol=1e-6, atol=1e-6)


def test_height_map_and_what_c_alone_refuses(field):
    poses = world.world_pose(world.path()[:, 0])
    soil = CField.of(field)
    soil.start(poses[0])
    origin, cell, shape = (0.05, 0.075), 0.1, (9, 7)
    flat = soil.height_map(origin, cell, shape)
    for pose in poses[1:]:
        soil.step(pose)
    points, heights = soil.particles(), soil.height_map(origin, cell, shape)
    expected = np.full(shape, np.nan, np.float32)
    for x, y, z in points:
        i, j = int((x - origin[0]) / cell), int((z - origin[1]) / cell)
        if i < shape[0] and j < shape[1] and not expected[i, j] >= y:
            expected[i, j] = y
    np.testing.assert_array_equal(heights, expected)
    assert np.nanmax(np.abs(heights - flat)) > 1e-3
    for change, message in (
        ({'bed': field.rest * 1e4}, 'range'),
        ({'bed': field.rest[:9]}, 'shape'),
        ({'index': 0}, 'no recorded starts'),
    ):
        with pytest.raises(ValueError, match=message):
            soil.start(poses[0], **change)
    with pytest.raises(ValueError, match='not started'):
        CField.of(field).step(poses[0])


@pytest.mark.parametrize(
    'operand, message',
    [
        ('tip ** 3', 'has no place in an operand'),
        ('height + (' * 8 + 'tip' + ')' * 8, 'more than the 8 values'),
    ],
)
def test_inputs_that_c_cannot_read_are_refused(field, monkeypatch, operand, message):
    table = Table((Row(operand),))
    monkeypatch.setattr(Blade, 'tables', Blade.tables.__class__(Blade.tables.own, table, table))
    with pytest.raises(ValueError, match=message):
        field_data.values(field)


def test_a_written_project_gives_the_same_bits_as_python(field, tmp_path):
    values, poses = field_data.values(field), world.world_pose(world.path()[:, 0])
    folder, built = str(tmp_path / 'project'), str(tmp_path / 'field.so')
    os.makedirs(folder)
    project.write(folder, 'lts_small', values)
    library.compile_sources(built, folder)
    soils = CField.open(built, 'lts_small'), CField.of(field)
    results = []
    for soil in soils:
        soil.start(poses[0])
        results.append(play(soil, poses[1:20]))
    for one, two in zip(*results):
        np.testing.assert_array_equal(one, two)
    assert not any('lts_step' in name for name in os.listdir(os.path.join(folder, 'src')))
