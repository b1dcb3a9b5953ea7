"""Strips against dense integrals."""

import numpy as np
import pytest

from learning_to_simulate.soil_field import strips
from learning_to_simulate.soil_field.place import place_of
from learning_to_simulate.soil_field.tools import Blade, Wheel
from tests.learning_to_simulate.soil_field import scenes

PLACE = place_of(scenes.poses([[0.1, 0.0, 0.0]], 0.6, (0.1, 0.0, 0.05))[0])


@pytest.mark.parametrize('width', [0.15, 0.3, 0.6, 1.5, 0.05])
def test_strips_lie_side_by_side_without_gaps(width):
    found = strips.strips_of(Blade(width))
    low, high = found.centres - found.widths / 2, found.centres + found.widths / 2
    np.testing.assert_allclose(low[1:], high[:-1], atol=1e-14)
    half = np.clip(width, 0.15, 0.6) / 2
    np.testing.assert_allclose([low[0], high[-1]], [-half - 0.3, half + 0.3])
    np.testing.assert_allclose([low[found.under][0], high[found.under][-1]], [-half, half])
    np.testing.assert_allclose(found.centres, -found.centres[::-1], atol=1e-15)


@pytest.mark.parametrize('tool, even', [(Wheel(0.05), False), (Blade(1.2), True)])
def test_one_strip_is_as_wide_as_its_tool(tool, even):
    found = strips.strips_of(tool, even)
    assert found.widths == pytest.approx([tool.width / tool.scale]) and found.centres == [0.0]
    low, share = found.shares(np.array([-1.0, 0.0, 2.0]))
    assert not low.any() and not share.any()


@pytest.mark.parametrize('tool', [Blade(0.5), Blade(1.2), Blade(0.1)])
def test_heights_are_means_over_the_width(tool):
    terrain, found, scale = scenes.hills(), strips.strips_of(tool), tool.scale
    u = np.linspace(-0.4, 0.4, 9) / scale
    read = strips.heights(terrain, PLACE, scale, found, u)
    share = (np.arange(400) + 0.5) / 400 - 0.5
    for j in range(11):
        across = scale * (found.centres[j] + found.widths[j] * share)
        points = np.stack(np.broadcast_arrays(scale * u[:, None], 0.0, across), axis=-1)
        x, _, z = np.moveaxis(PLACE.world(points), -1, 0)
        np.testing.assert_allclose(read[j], terrain.at(x, z).mean(axis=1) / scale, atol=2e-4)
    assert np.ptp(read, axis=0).max() > 0.01
