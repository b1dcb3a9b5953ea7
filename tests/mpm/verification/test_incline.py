"""The periodic incline, on a small layer."""

import numpy as np
import pytest

from mpm import columns
from mpm.verification import incline


def test_closed_form_has_one_inertial_number():
    soil, depth = incline.beads(), 0.15
    height = np.linspace(0.0, 0.14, 50)
    step = 1e-7
    rate = incline.closed_form(height + step, depth, 26.0, soil)
    rate = (rate - incline.closed_form(height - step, depth, 26.0, soil)) / (2 * step)
    pressure = soil.bulk_density * 9.81 * np.cos(np.radians(26.0)) * (depth - height)
    number = rate * soil.grain_diameter * np.sqrt(soil.grain_density / pressure)
    np.testing.assert_allclose(number[1:], incline.inertial_number(soil, 26.0), rtol=1e-5)
    rise = number[1] / soil.inertial_number_0
    friction = soil.mu_s + (soil.mu_2 - soil.mu_s) * rise / (1 + rise)
    assert friction == pytest.approx(np.tan(np.radians(26.0)), rel=1e-6)


def test_law_is_well_posed_for_beads_alone():
    """Coulomb friction, I = 0, is ill-posed always; beads are well-posed in the flow here."""
    beads, soil = incline.beads(), incline.soil_of_blade()
    assert incline.posedness(beads, 0.0) == pytest.approx(beads.mu_s**2)
    assert incline.posedness(beads, incline.inertial_number(beads, incline.FLOWING_DEG)) < 0.0
    assert min(incline.posedness(soil, number) for number in np.geomspace(1e-4, 1e2, 100)) > 0.0


def test_the_seam_is_nowhere():
    """A layer that is moved by half a period flows as the one that is not."""
    layer = incline.Incline(incline.layer_bin(), incline.beads())
    layer.start(lambda y: 0.2 * y / layer.depth)
    first = layer.particles.copy()
    layer.advance(0.02, 26.0)
    there = layer.particles
    layer.particles = first
    half = 0.5 * layer.period
    layer.particles[:, [0, 2]] += half
    layer.wrap()
    layer.advance(0.02, 26.0)
    layer.particles[:, [0, 2]] += half
    layer.wrap()
    apart = np.abs(layer.particles - there)
    assert np.abs(there - first)[:, columns.V].max() > 0.01  # m/s: it has sped up
    assert apart[:, columns.V : columns.C].max() < 1e-6  # m/s
    assert np.abs(there[:, :3] - first[:, :3]).max() > 1e-3  # m
    wrapped = np.minimum(apart[:, [0, 2]], layer.period - apart[:, [0, 2]])
    assert max(wrapped.max(), apart[:, 1].max()) < 1e-8  # m


def test_beads_flow_as_the_closed_form_and_stop_below_the_static_angle():
    found = incline.bagnold(8.0, 0.2, 0.4)
    assert found['profile'] < 0.03  # measured 0.014
    assert found['depth'] == pytest.approx(1.0, abs=0.01)
    assert abs(incline.halt(incline.beads(), 19.0, 8.0, seconds=0.8)) < 5e-3  # m/s, of 0.1
