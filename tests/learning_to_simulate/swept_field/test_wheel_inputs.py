"""Inputs of a wheel's networks against a numpy twin, and what their outputs mean."""

import numpy as np
import pytest

from learning_to_simulate.methods.swept_field import wheel_inputs, wheel_path
from learning_to_simulate.methods.swept_field.wheel_inputs import WheelInputs
from tests.learning_to_simulate.methods.swept_field import small_wheel as world

C = wheel_path
GIVEN = WheelInputs(world.GRID)


def named(scalars):
    return dict(zip(wheel_path.SCALARS, scalars.astype(float)))


def at(bins, channel, place):
    return np.interp(place, world.GRID.offsets, bins[:, channel].astype(float))


def of_drive(s):
    """What both networks see of the drive."""
    weight = 1700.0 * s['gravity'] * s['radius'] ** 2 * 2 * s['half_width']
    a = s['contact']
    return [
        np.log(s['first_load'] / weight) / 2, (s['friction'] - 0.75) / 0.15,
        np.log(s['radius'] / 0.075), np.log(max(s['sunk'], 0.002) / s['radius']),
        s['load'] / s['first_load'] - 1, s['peak_load'] / s['first_load'] - 1,
        s['tip'] / a / 3, np.tanh(s['tip'] / a), np.tanh(abs(s['tip']) / (0.3 * a)),
        s['rolled'] / a / 3, np.tanh(s['rolled'] / a), np.log1p(s['slipped'] / 0.004) / 2,
        np.log1p(s['slipped'] / a), np.log1p(s['travelled'] / a),
        (s['foremost'] - s['tip']) / a, (s['tip'] - s['rearmost']) / a,
        np.tanh(s['foremost'] / a), np.tanh(s['rearmost'] / a),
    ]  # fmt: skip


def of_particle(bins, s, rest):
    """Gate and inputs of one particle in one frame."""
    u, y, z = (float(v) for v in rest)
    a, radius, half = s['contact'], s['radius'], s['half_width']
    surface, cut = at(bins, C.SURFACE, u), at(bins, C.CUT, u)
    below = (at(bins, C.DISTURBED, u) + 0.05 - (surface - y)) / 0.02
    beside = (half + 0.08 - abs(z)) / 0.03
    gate = at(bins, C.INFLUENCE, u) * np.clip(below, 0, 1) * np.clip(beside, 0, 1)
    behind, above = s['tip'] - u, y - surface + cut
    rim = np.hypot(behind, y - s['height']) - radius
    first = np.hypot(u, y - radius + s['sunk']) - radius
    values = [
        behind / 0.1, np.tanh(behind / 0.015), np.tanh(behind / a),
        *(np.exp(-((behind / a - c) ** 2)) for c in (-1, 0, 1)),
        u / 0.1, np.tanh(u / a), np.tanh((s['foremost'] - u) / a), np.tanh((s['rearmost'] - u) / a),
        (y - surface) / 0.03, np.tanh((y - surface) / 0.01), (y - s['height'] + radius) / 0.03,
        rim / 0.03, np.tanh(rim / 0.01), np.tanh(first / 0.01),
        abs(z) / 0.06, np.tanh((abs(z) - half) / 0.015), np.tanh((abs(z) - half) / 0.04),
        above / 0.02, np.tanh(above / 0.005), s['end'] - u,
    ]  # fmt: skip
    places = u + wheel_inputs.AROUND
    values += list(at(bins, C.CUT, places) / 0.02)
    values += list((at(bins, C.CUT, places) - at(bins, C.FIRST_CUT, places)) / 0.01)
    values += list((at(bins, C.SURFACE, places) - surface) / 0.02)
    places = u + wheel_inputs.SLIP_AROUND
    values += list(np.exp(-at(bins, C.SINCE, places) / 0.05))
    values += list(np.log1p(at(bins, C.SLID, places) / 0.004))
    values += list(np.tanh(at(bins, C.SHEAR, places) / 0.004))
    values += list(at(bins, C.SHEAR, places) / 0.03)
    values += list(at(bins, C.PEAK, places) / s['first_load'])
    return gate, np.array(values + of_drive(s) + [(s['height'] - radius) / 0.02])


def test_particles_see_what_the_twin_does():
    plane = world.path()
    frames = world.frames(plane)
    rest = world.AXES.points(world.bed_points()) - [plane[0, 0, 0], world.SURFACE, 0.0]
    rest = rest[np.abs(rest[:, 0]) < 0.15][::97].astype(np.float32)
    gates = []
    for t in (3, 20, 60):
        one = frames.bins[t : t + 1], frames.scalars[t : t + 1], rest[None]
        gate, seen = GIVEN.gate(*one).numpy()[0], GIVEN.particles(*one).numpy()[0]
        for p, place in enumerate(rest):
            wanted_gate, wanted = of_particle(frames.bins[t], named(frames.scalars[t]), place)
            assert gate[p] == pytest.approx(wanted_gate, abs=1e-4)
            np.testing.assert_allclose(seen[p], wanted, atol=3e-3, rtol=2e-3)
        gates.append(gate)
    assert not gates[0].any() and gates[-1].max() == 1 and gates[-1].min() == 0


def test_the_load_sees_what_the_twin_does_and_nothing_of_the_height():
    plane = world.path()
    frames = world.frames(plane)
    seen = GIVEN.force(frames.bins, frames.scalars).numpy()
    for t in (0, 20, 60):
        s, bins = named(frames.scalars[t]), frames.bins[t]
        wanted = of_drive(s)
        for ending in ('', '_0', '_1', '_2'):
            speed, rim = s['speed' + ending], s['rim' + ending]
            size = np.sqrt(speed**2 + rim**2 + 1e-6)
            wanted += [(rim - speed) / size, rim / size, speed / size]
        places = s['tip'] + s['contact'] * wheel_inputs.AT_CONTACT
        wanted += list(np.exp(-at(bins, C.SINCE, places) / 0.05))
        wanted += list(np.log1p(at(bins, C.SLID, places) / 0.004) / 2)
        wanted += list(np.tanh(at(bins, C.SHEAR, places) / 0.004))
        wanted += list(at(bins, C.PEAK, places) / s['first_load'])
        wanted += [np.tanh((s['end'] - s['tip']) / 0.1)]
        np.testing.assert_allclose(seen[t], wanted, atol=3e-3, rtol=2e-3)
    other = plane.copy()
    other[1:, 0, 1] -= 0.02
    there = world.frames(other)
    np.testing.assert_array_equal(GIVEN.force(there.bins, there.scalars).numpy(), seen)
    assert np.abs(there.bins - frames.bins).max() > 0.01


def test_a_wheel_bears_its_load_and_stands_still_at_rest():
    frames = world.frames(world.path())
    share = GIVEN.load_share(frames.bins, frames.scalars)
    found = GIVEN.load_of(np.zeros((1, len(frames.bins), 4), np.float32), share).numpy()[0]
    load = world.path()[:, 0, 3]
    mean = np.concatenate([load[:1], (load[1:] + load[:-1]) / 2])
    np.testing.assert_allclose(found[:, 1], mean, rtol=1e-5)
    assert not found[:, [0, 2, 3]].any()
    ones = GIVEN.load_of(np.ones((1, len(frames.bins), 4), np.float32), share).numpy()[0]
    np.testing.assert_allclose(ones[:, 2], world.RADIUS * ones[:, 0], rtol=1e-5)
    assert not ones[:6, 3].any() and ones[-1, 3] == pytest.approx(0.006 + 0.002, rel=1e-4)
