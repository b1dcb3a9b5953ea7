"""Memory of a wheel's drive and its rut against a plain sum over time; bad input."""

import numpy as np
import pytest

from learning_to_simulate.methods.swept_field import wheel_path
from learning_to_simulate.methods.swept_field.tool_path import Bed
from tests.learning_to_simulate.methods.swept_field import small_wheel as world

S = {name: i for i, name in enumerate(wheel_path.SCALARS)}


def twin(plane, dt):
    """What bins have borne at the end of a path, bin by bin and frame by frame."""
    radius, first = world.RADIUS, plane[0, 0]
    sunk = world.SURFACE - first[1] + radius
    contact = np.sqrt(sunk * (2 * radius - sunk))
    bins = first[0] + world.GRID.offsets
    slid, shear, peak, since = (np.zeros(len(bins)) for _ in range(4))
    profile = np.full(len(bins), world.SURFACE)
    for k, place in enumerate(bins):
        travelled, last = 0.0, -np.inf
        for t, (u, height, turned, load) in enumerate(plane[:, 0]):
            borne = max(1 - ((place - u) / contact) ** 2, 0)
            if t:
                before = plane[t - 1, 0]
                slip = radius * (turned - before[2]) - (u - before[0])
                mean = (borne + max(1 - ((place - before[0]) / contact) ** 2, 0)) / 2
                slid[k] += mean * abs(slip)
                shear[k] += mean * slip
                travelled += abs(u - before[0])
            if borne > 0:
                last = travelled
            peak[k] = max(peak[k], min(borne / 0.2, 1) * load)
            if abs(place - u) < radius:
                rim = height - np.sqrt(radius**2 - (place - u) ** 2)
                profile[k] = min(profile[k], rim)
        since[k] = min(travelled - last, world.GRID.forget)
    return slid, shear, peak, since, world.SURFACE - profile


def test_bins_are_those_of_the_twin():
    plane = world.path()
    bins = world.frames(plane).bins[-1]
    slid, shear, peak, since, cut = twin(plane, world.DT)
    assert slid.max() > 0.01 and shear.max() > 0.01 and cut.max() > 0.01
    np.testing.assert_allclose(bins[:, wheel_path.SLID], slid, atol=1e-6)
    np.testing.assert_allclose(bins[:, wheel_path.SHEAR], shear, atol=1e-6)
    np.testing.assert_allclose(bins[:, wheel_path.PEAK], peak, rtol=1e-5)
    np.testing.assert_allclose(bins[:, wheel_path.SINCE], since, atol=1e-6)
    # Between frames the rim goes on: the straight way is a little below both ends.
    np.testing.assert_allclose(bins[:, wheel_path.CUT], cut, atol=1e-4)


def test_shifting_the_scene_changes_nothing():
    plane, shift = world.path(), np.array([3.0, 0.5, 0.0, 0.0])
    here = world.frames(plane)
    bed = world.flat_bed(plane[0, 0, 0])
    bed = Bed(bed.surface + 0.5, bed.level + 0.5, bed.end + 3.0)
    _, there = world.WHEEL.frames(world.GRID, bed, world.SIZE[None], plane + shift, world.DT)
    np.testing.assert_allclose(there.bins[:, 0], here.bins, atol=1e-5)
    np.testing.assert_allclose(there.scalars[:, 0], here.scalars, atol=1e-4, rtol=1e-5)


def test_at_twice_the_rate_the_state_is_nearly_the_same():
    one = world.frames(world.path())
    _, two = world.WHEEL.frames(
        world.GRID, world.flat_bed(-0.38), world.SIZE[None], world.path(121, world.DT / 2),
        world.DT / 2,
    )  # fmt: skip
    for channel in range(wheel_path.CHANNELS):
        there, here = two.bins[-1, 0, :, channel], one.bins[-1, :, channel]
        apart = np.sqrt(((there - here) ** 2).mean())
        # A bin more or less is borne on at the ends of the way.
        assert apart <= 0.05 * max(np.sqrt((here**2).mean()), 1e-9), channel
    for name in ('rolled', 'slipped', 'travelled', 'speed_1', 'rim_1', 'area', 'peak_load'):
        assert two.scalars[-1, 0, S[name]] == pytest.approx(
            one.scalars[-1, S[name]], rel=0.03, abs=1e-5
        )


def test_nothing_stirs_before_the_wheel_does():
    """Frames before it moves show the first sinkage alone; then the influence grows from 0."""
    found = world.frames(world.path())
    at_rest = slice(0, 6)
    assert not found.bins[at_rest, :, wheel_path.INFLUENCE].any()
    assert found.bins[0, :, wheel_path.CUT].max() == pytest.approx(0.006, abs=1e-5)
    np.testing.assert_array_equal(
        found.bins[0, :, wheel_path.CUT], found.bins[0, :, wheel_path.FIRST_CUT]
    )
    assert found.bins[-1, :, wheel_path.INFLUENCE].max() == 1
    far = np.abs(world.GRID.offsets) > wheel_path.REACH + 0.06 + 0.04
    assert not found.bins[-1, far, wheel_path.INFLUENCE].any()


def test_the_bed_under_the_wheel_is_level_with_its_neighbours():
    """A bed that is read with the wheel on it has its print; the cut is counted from without."""
    bed = world.flat_bed(-0.38)
    surface = bed.surface.copy()
    surface[:, np.abs(world.GRID.offsets) < 0.02] -= 0.006
    plane = world.path()[:1]
    drive, rut = wheel_path.start(
        world.GRID, bed._replace(surface=surface), world.SIZE[None], plane[0]
    )
    np.testing.assert_allclose(rut.surface, world.SURFACE)
    assert drive.sunk == pytest.approx(0.006)


@pytest.mark.parametrize(
    'change, message',
    [
        (lambda p: p + [1.0, 0, 0, 0], 'bins'),
        (lambda p: p * np.nan, 'not finite'),
        (lambda p: p[:, :3], 'shape'),
    ],
)
def test_bad_poses_are_refused(change, message):
    plane = world.path()
    state = wheel_path.start(world.GRID, world.flat_bed(-0.38), world.SIZE[None], plane[0])[0]
    with pytest.raises(ValueError, match=message):
        wheel_path.drive_on(world.GRID, state, change(plane[1]), world.DT)
    with pytest.raises(ValueError, match='time does not go back'):
        wheel_path.drive_on(world.GRID, state, plane[1], 0.0)
