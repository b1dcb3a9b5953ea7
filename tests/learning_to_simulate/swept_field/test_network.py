"""What the networks see, against a numpy twin that reads the same tables; what their outputs mean.

The numbers in the tables themselves are held by the shipped models, which answer otherwise.
"""

import numpy as np
import pytest

from learning_to_simulate.swept_field.network import BladeInputs, WheelInputs
from learning_to_simulate.tool import inputs
from tests.learning_to_simulate.swept_field import small_wheel, small_world

FUNCTIONS = {
    'abs': np.abs, 'relu': lambda x: np.maximum(x, 0), 'sqrt': np.sqrt, 'log': np.log,
    'log1p': np.log1p, 'max': np.maximum,
}  # fmt: skip
SQUASHES = {
    'plain': lambda t: t, 'tanh': np.tanh, 'relu': lambda t: np.maximum(t, 0),
    'relu2': lambda t: np.maximum(t, 0) ** 2, 'bell': lambda t: np.exp(-(t**2)),
    'fade': lambda t: np.exp(-t), 'log': np.log, 'log1p': np.log1p,
}  # fmt: skip
WORLDS = {
    'blade': (small_world, small_world.BLADE, BladeInputs),
    'wheel': (small_wheel, small_wheel.WHEEL, WheelInputs),
}


@pytest.fixture(params=WORLDS)
def seen(request):
    """(tool, `Inputs`, function of a frame's bins, frames, particles at rest)."""
    world, tool, kind = WORLDS[request.param]
    plane = world.path()
    rest = world.AXES.points(world.bed_points()) - [plane[0, 0, 0], world.SURFACE, 0.0]
    rest = rest[np.abs(rest[:, 0]) < 0.3][::23].astype(np.float32)

    def at(bins, name, place):
        channel = bins[:, tool.channels.index(name)].astype(float)
        return np.interp(place, world.GRID.offsets, channel)

    return tool, kind(tool, world.GRID), at, world.frames(plane), rest


def twin(tool, at, table, bins, scalars, place=None):
    """Inputs of one frame, or of one particle in it."""
    values = dict(zip(tool.scalars, scalars.astype(float)))
    if place is not None:
        values |= dict(zip('uyz', map(float, place)))
        values |= {name: at(bins, name, values['u']) for name in tool.channels}
    found = []
    for row in table.rows:
        for offset in row.at or [0.0]:
            where = values[table.place] + offset * (values[table.unit] if table.unit else 1.0)
            there = {f'at.{name}': at(bins, name, where) for name in tool.channels}
            value = inputs.evaluate(row.operand, values | there, FUNCTIONS)
            found.append(SQUASHES[row.squash]((value - row.shift) / row.scale))
    return np.array(found)


def test_inputs_and_gates_are_those_of_the_twin(seen):
    tool, given, at, frames, rest = seen
    gates = []
    for t in (3, 20, 60):
        bins, scalars = frames.bins[t], frames.scalars[t]
        half = scalars[tool.scalars.index('half_width')]
        one = bins[None], scalars[None], rest[None]
        gate, own = given.gate(*one).numpy()[0], given.particles(*one).numpy()[0]
        shared = twin(tool, at, tool.tables.shared, bins, scalars)
        for p, (u, y, z) in enumerate(rest.astype(float)):
            wanted = twin(tool, at, tool.tables.own, bins, scalars, (u, y, z))
            np.testing.assert_allclose(own[p], [*wanted, *shared], atol=3e-3, rtol=2e-3)
            depth = at(bins, 'surface', u) - y
            below = np.clip((at(bins, 'disturbed', u) + tool.below - depth) / tool.below_ramp, 0, 1)
            beside = np.clip((half + tool.beside - abs(z)) / tool.beside_ramp, 0, 1)
            assert gate[p] == pytest.approx(at(bins, 'influence', u) * below * beside, abs=1e-4)
        force = given.force(bins[None], scalars[None]).numpy()[0]
        wanted = twin(tool, at, tool.tables.force, bins, scalars)
        np.testing.assert_allclose(force, wanted, atol=3e-3, rtol=2e-3)
        assert (own.shape[1], len(force)) == given.sizes
        gates.append(gate)
    assert not gates[0].any() and gates[-1].max() > 0.8 and gates[-1].min() == 0


def test_a_blade_touches_soil_where_its_network_may_say_anything():
    plane = small_world.path()
    away = plane[-1:] + np.linspace(0, 0.3, 40)[:, None, None] * [0, 1, 0]
    frames = small_world.frames(np.concatenate([plane, away]))
    share = BladeInputs(small_world.BLADE, small_world.GRID).contact(*frames).numpy()
    assert share.min() == 0 and share.max() == 1
    np.testing.assert_array_equal(small_world.BLADE.touches(small_world.GRID, frames), share > 0)


def test_the_load_of_a_wheel_sees_nothing_of_its_height():
    given = WheelInputs(small_wheel.WHEEL, small_wheel.GRID)
    plane = small_wheel.path()
    other = plane.copy()
    other[1:, 0, 1] -= 0.02
    here, there = small_wheel.frames(plane), small_wheel.frames(other)
    np.testing.assert_array_equal(given.force(*there).numpy(), given.force(*here).numpy())
    assert np.abs(there.bins - here.bins).max() > 0.01


def test_a_wheel_bears_its_load_and_stands_still_at_rest():
    frames = small_wheel.frames(small_wheel.path())
    given = WheelInputs(small_wheel.WHEEL, small_wheel.GRID)
    share = given.load_share(*frames)
    found = given.load_of(np.zeros((1, len(frames.bins), 4), np.float32), share).numpy()[0]
    load = small_wheel.path()[:, 0, 3]
    mean = np.concatenate([load[:1], (load[1:] + load[:-1]) / 2])
    np.testing.assert_allclose(found[:, 1], mean, rtol=1e-5)
    assert not found[:, [0, 2, 3]].any()
    ones = given.load_of(np.ones((1, len(frames.bins), 4), np.float32), share).numpy()[0]
    np.testing.assert_allclose(ones[:, 2], small_wheel.RADIUS * ones[:, 0], rtol=1e-5)
    assert not ones[:6, 3].any() and ones[-1, 3] == pytest.approx(0.006 + 0.002, rel=1e-4)
