"""The members of a network; what the networks of a field see and say is held against C in
`native/test_soil_engine`, their symmetries in `test_shipped_fields`."""

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate.soil_field import network, settings
from learning_to_simulate.soil_field.tools import Blade, Wheel

SIZES = [3, 5, 4, 2]


@pytest.mark.parametrize('tool', [Blade, Wheel])
def test_weights_of_a_model_take_at_most_400_kb(tool):
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
