"""Symmetries of what the networks say; what they see and say is held against C in
`native/test_soil_engine`."""

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate.soil_field import network, settings, sweep
from learning_to_simulate.soil_field.tools import Blade, Wheel
from tests.learning_to_simulate.soil_field import scenes
from tests.learning_to_simulate.soil_field.scenes import PATH, poses, walk

TOOLS = {'blade': Blade(0.3), 'wheel': Wheel(0.1, 0.1, 8, 0.01)}
RISES = {'blade': 0.0, 'wheel': 0.08}  # of the circle's centre over that of a blade
HIDDEN = {'load': (6,), 'surface': (7,), 'soil': (5, 4)}
SIZES = [3, 5, 4, 2]
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
def test_weights_of_a_model_take_at_most_400_kib(tool):
    members = settings.PRESETS['soil_field'].members
    nets = network.SoilNetworks(tool, members, 0)
    numbers = sum(np.prod(v.shape) for v in nets.trainable_variables)
    assert members == 3 and 4 * numbers <= 400_000


@pytest.mark.parametrize('first', [None, 1, 2])
def test_members_are_perceptrons_that_know_nothing_of_each_other(first):
    members = network.Members(3, SIZES, 7, 'some')
    x = np.random.default_rng(0).normal(size=(6, 3))
    found = members(tf.constant(x, tf.float32), first).numpy()
    wanted = []
    for m in range(3 if first is None else first):
        y = x
        for i, (weight, bias) in enumerate(members.layers):
            y = y if i == 0 else y / (1 + np.exp(-y))  # silu
            y = y @ weight.numpy()[m] + bias.numpy()[m]
        wanted.append(y)
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    assert not np.allclose(wanted[0], wanted[-1]) or first == 1


def test_first_weights_are_those_of_the_seed_and_the_last_layer_is_small():
    one, same, other = (network.Members(2, SIZES, seed, 'some').layers for seed in (1, 1, 2))
    for a, b, c in zip(one, same, other):
        np.testing.assert_array_equal(a[0], b[0])
        assert not np.array_equal(a[0], c[0]) and not np.any(a[1])
    assert np.std(one[-1][0]) < 0.3 * np.std(one[0][0])
