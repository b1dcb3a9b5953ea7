"""What the networks see and say, against a numpy twin that reads the same tables; symmetries."""

import numpy as np
import pytest

from learning_to_simulate.soil_field import inputs, network, settings, sweep
from learning_to_simulate.soil_field.inputs import TABLES
from learning_to_simulate.soil_field.tools import Blade, Wheel
from tests.learning_to_simulate.soil_field import scenes
from tests.learning_to_simulate.soil_field.scenes import PATH, poses, walk

FUNCTIONS = {'abs': np.abs, 'relu': lambda x: np.maximum(x, 0), 'sqrt': np.sqrt}
SQUASHES = {
    'plain': lambda t: t, 'tanh': np.tanh, 'relu': lambda t: np.maximum(t, 0),
    'relu2': lambda t: np.maximum(t, 0) ** 2, 'bell': lambda t: np.exp(-(t**2)),
    'fade': lambda t: np.exp(-t),
}  # fmt: skip
TOOLS = {'blade': Blade(0.3), 'wheel': Wheel(0.1, 0.1, 8, 0.01)}
RISES = {'blade': 0.0, 'wheel': 0.08}  # of the circle's centre over that of a blade
HIDDEN = {'load': (6,), 'surface': (7,), 'soil': (5, 4)}
RNG = np.random.default_rng(0)
# u from the tool, height, across: on both sides of all that changes over, and far away.
PLACES = RNG.uniform((-0.4, -0.15, -0.5), (0.4, 0.02, 0.5), (40, 3))
PLACES[:3, 2] = [0.0, 0.03, -0.03]


def made(name):
    """Networks whose weights and biases are all of order 1."""
    nets = network.SoilNetworks(type(TOOLS[name]), 2, 0, HIDDEN)
    for part in (nets.load, nets.surface, nets.soil):
        for k, (weight, bias) in enumerate(part.layers):
            last = k == len(part.layers) - 1
            weight.assign((3 if last else 0.5) * weight)
            bias.assign(0.3 * np.random.default_rng(k).normal(size=bias.shape))
    nets.load.layers[-1][1].assign_add([[[0.0, 0.0, 0.0, 0.0, 3.0]]] * 2)  # large forces
    return nets


NETS = {name: made(name) for name in TOOLS}


@pytest.fixture(params=TOOLS)
def name(request):
    return request.param


def scene(name, terrain=None, pose=None, frames=(1, 3, -1), **more):
    """(networks, strips, some frames on hills)."""
    path = PATH + [0.0, RISES[name], 0.0]
    passage, found = walk(
        scenes.hills() if terrain is None else terrain, TOOLS[name],
        poses(path) if pose is None else pose, **more,
    )  # fmt: skip
    return NETS[name], passage.strips, [found[t] for t in frames]


def about(frame, columns=(0, 1, 2)):
    """`PLACES` about the tool of a frame, from its origin and level; some columns."""
    places = PLACES + np.array([1.0, 0.0, 0.0]) * frame.scalars[0, 0, 0]
    return places[:, columns].astype(np.float32)


def stacked(frames):
    """Frames as one of a batch."""
    return sweep.Frame(*map(np.concatenate, zip(*frames, strict=True)))


def ask(call, frames, strip, places):
    """`rise` or `displacement` [M, B, P, ...] at places [B, P, ...] of frames."""
    return call(*frames, places, network.looks(strip, places[..., -1])).numpy()


class Twin:
    """One frame in numpy and float64."""

    def __init__(self, tool, strip, frame):
        self.tool, self.strip = tool, strip
        self.bins = frame.bins[0].astype(float)
        self.scalars = frame.scalars[0].astype(float)
        self.names = network.names_of(tool)

    def channels(self, across):
        """Name -> function of u: linear along and across; beyond the outermost strips, these."""
        j = np.clip(np.searchsorted(self.strip.centres, across), 1, max(len(self.bins) - 1, 1))
        near, far = self.bins[j - 1], self.bins[min(j, len(self.bins) - 1)]
        share = [0.0, 1.0] if len(self.bins) > 1 else [0.0, np.inf]
        b = np.interp(across, self.strip.centres[j - 1 : j + 1], share[: len(self.bins)])
        mixed = near + b * (far - near)
        return {
            n: lambda u, i=i: np.interp(u, sweep.GRID.offsets, mixed[:, i])
            for i, n in enumerate(sweep.CHANNELS)
        }

    def scalar(self, across):
        return {
            n: np.interp(across, self.strip.centres, self.scalars[:, i])
            for i, n in enumerate(self.names)
        }

    def read(self, table, place, across, values, beside=None):
        """Inputs of a table for one place."""
        found, at = [], self.channels(across)
        if beside is not None:
            other = self.channels(beside)
            at['beside'] = lambda u: other['surface'](u) - other['cut'](u)
        for row in table.rows:
            places = place + np.array(row.at or [0.0])
            names = inputs.names(row.operand)
            there = {n: at[n[3:]](places) for n in names if n.startswith('at.')}
            value = inputs.evaluate(row.operand, values | there, FUNCTIONS)
            found.append(np.atleast_1d(SQUASHES[row.squash]((value - row.shift) / row.scale)))
        return np.concatenate(found)

    def mlp(self, part, member, values):
        for k, (weight, bias) in enumerate(part.layers):
            values = values / (1 + np.exp(-values)) if k else values
            values = values @ weight[member].numpy() + bias[member, 0].numpy()
        return values

    def strips_under(self):
        count = len(self.strip.centres)
        return range(3, 8) if count > 1 else range(count)

    def load(self, nets):
        """(10) to (12)."""
        total = np.zeros((2, 6))
        under, c = self.strips_under(), self.strip.centres
        tables = TABLES[self.tool.name]
        for j in under:
            values = self.scalar(c[j])
            tip, width = values['tip'], 2 * values['half_width']
            own = self.read(tables.load, tip, c[j], values)
            highest = max(self.channels(c[j])['surface'](tip + np.array(network.AROUND_TOOL)))
            gap = values['height'] - values['radius'] - highest
            heap = np.sqrt(2 * np.tan(np.radians(35)) * max(values['area'], values['carried']))
            kappa = np.clip((heap + 0.02 - gap) / 0.01, 0, 1)
            for sign in (-1, 1):  # the neighbour on the left, which presses to the right
                beside = c[j + sign] if len(c) > 1 else c[j]
                side = self.read(tables.side, tip, c[j], values, beside)
                for m in range(2):
                    out = self.mlp(nets.load, m, np.concatenate([own, side]))
                    n, out = out, out[:4] * np.exp(np.clip(out[4], -4, 4)) * [100, 100, 10, 100]
                    out *= kappa * width / len(under) / network.WIDTH[self.tool.name]
                    if self.tool.name == 'wheel':  # friction of what it bears
                        out = out[1] * np.array([n[0], 1.0, 0.1 * n[2], n[3]])
                    lever = np.cross([0, 0, c[j]], [out[0] / 2, out[1] / 2, 0])
                    total[m, :3] += [out[0] / 2, out[1] / 2, -sign * out[3]]
                    total[m, 3:] += lever + [0, 0, out[2] / 2]
        return total

    def here(self, u, z):
        """(values, inputs around a place, its terrain beside, inputs of the tool, g)."""
        values = self.scalar(z) | {'u': u, 'z': z}
        values |= {n: at(u) for n, at in self.channels(z).items()}
        sign, tables = (1 if z >= 0 else -1), TABLES[self.tool.name]
        beside = [
            min(abs(z) / 0.05, 1)
            * (self.channels(z + d * sign * 0.1)['surface'](u) - values['surface']) / 0.03
            for d in (1, -1)
        ]  # fmt: skip
        gate = values['influence'] * np.clip(values['way'] / 0.005, 0, 1)
        gate *= np.clip((values['half_width'] + 0.3 - abs(z)) / 0.05, 0, 1)
        around = self.read(tables.here, u, z, values)
        return values, around, beside, self.read(tables.tool, values['tip'], z, values), gate

    def moved(self, nets, u, y, z):
        """(13) to (15): how the surface rises [2], how a particle moves [2, 3]."""
        values, around, beside, stands, gate = self.here(u, z)
        seen = np.concatenate([around, beside, stands])
        rise = [0.03 * gate * self.mlp(nets.surface, m, seen)[0] for m in range(2)]
        own = self.read(TABLES[self.tool.name].particle, u, z, values | {'y': y})
        deep = values['disturbed'] + 0.05 - (values['surface'] - y)
        gate *= 0.03 * np.clip(deep / 0.03, 0, 1)
        gates, seen = gate * np.array([1, 1, np.clip(z / 0.05, -1, 1)]), [around, own, beside]
        seen = np.concatenate([*seen, stands])
        return rise, [gates * self.mlp(nets.soil, m, seen) for m in range(2)]


def test_loads_are_those_of_the_twin(name):
    nets, strip, frames = scene(name)
    found = nets.loads(*stacked(frames)).numpy()
    assert found.shape == (2, 3, 6) and np.ptp(np.linalg.norm(found, axis=2)) > 1
    wanted = np.stack([Twin(TOOLS[name], strip, frame).load(nets) for frame in frames], axis=1)
    np.testing.assert_allclose(found, wanted, rtol=2e-3, atol=2e-3)


def test_rise_and_displacement_are_those_of_the_twin(name):
    nets, strip, frames = scene(name, frames=(3, -1))
    both, places = stacked(frames), np.stack([about(frame) for frame in frames])
    risen = ask(nets.rise, both, strip, places[..., [0, 2]])
    moved = ask(nets.displacement, both, strip, places)
    for t, frame in enumerate(frames):
        twin = Twin(TOOLS[name], strip, frame)
        for p, place in enumerate(places[t, :16].astype(float)):
            wanted = twin.moved(nets, *place)
            np.testing.assert_allclose(risen[:, t, p], wanted[0], atol=2e-5)
            np.testing.assert_allclose(moved[:, t, p], wanted[1], atol=2e-5)
    assert np.abs(risen).max() > 0.003 and np.abs(moved[..., 2]).max() > 0.003


def test_a_mirrored_frame_has_a_mirrored_load_and_motion(name):
    nets, strip, frames = scene(name)
    places = np.stack([about(frame) for frame in frames])
    both = stacked([*frames, *(sweep.Frame(f.bins[:, ::-1], f.scalars[:, ::-1]) for f in frames)])
    # A torque along or up turns the other way in a mirror, that across stays.
    load, other = np.split(nets.loads(*both), 2, axis=1)
    np.testing.assert_allclose(other, load * [1, 1, -1, -1, -1, 1], rtol=1e-4, atol=1e-4)
    if name == 'blade':
        assert np.abs(load[..., 2:5]).max(axis=(0, 1)).min() > 0.05
    places = np.concatenate([places, places * np.float32([1, 1, -1])])
    moved, other = np.split(ask(nets.displacement, both, strip, places), 2, axis=1)
    np.testing.assert_allclose(other, moved * [1, 1, -1], atol=1e-6)
    risen, other = np.split(ask(nets.rise, both, strip, places[..., [0, 2]]), 2, axis=1)
    np.testing.assert_allclose(other, risen, atol=1e-6)


def test_in_the_air_there_is_no_load_and_soil_rests(name):
    up = PATH * [1, 0, 1] + [0.0, 0.3, 0.0]
    nets, strip, frames = scene(name, pose=poses(up), frames=(0, 4, -1))
    places = np.stack([about(frame) for frame in frames])
    assert not nets.loads(*stacked(frames)).numpy().any()
    assert not ask(nets.rise, stacked(frames), strip, places[..., [0, 2]]).any()
    assert not ask(nets.displacement, stacked(frames), strip, places).any()


@pytest.mark.parametrize('tool', [Blade, Wheel])
def test_weights_of_a_model_take_at_most_400_kb(tool):
    members = settings.PRESETS['soil_field'].members
    nets = network.SoilNetworks(tool, members, 0)
    numbers = sum(np.prod(v.shape) for v in nets.trainable_variables)
    assert members == 3 and 4 * numbers <= 400e3
