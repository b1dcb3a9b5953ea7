"""The equation of earthmoving against limit equilibrium written anew, and against closed forms."""

import dataclasses
import math

import pytest

from learning_to_simulate.baselines import earthmoving
from learning_to_simulate.baselines.earthmoving import BladeSoil
from mpm import bodies
from mpm.earthmoving import draft_force

SOIL = BladeSoil(
    unit_weight=17e3, friction_angle=0.65, wall_angle=0.29, repose_angle=0.6, width=0.457,
    height=0.3,
)  # fmt: skip


@pytest.mark.parametrize('depth, rake_deg', [(0.02, 90.0), (0.05, 86.0), (0.1, 60.0), (0.1, 45.0)])
def test_force_is_that_of_the_force_polygon(depth, rake_deg):
    """Twin: the solver's own check finds the same wedge from the equilibrium of forces."""
    rake = math.radians(rake_deg)
    expected = draft_force(
        depth, SOIL.width, rake, SOIL.friction_angle, SOIL.wall_angle, SOIL.unit_weight
    )
    parts = earthmoving.cutting_force(depth, rake, 0.0, SOIL)
    assert parts[0, 0] == pytest.approx(expected, rel=2e-3)
    assert (parts[1] == 0).all()
    angle = rake + SOIL.wall_angle
    assert parts[0, 1] == pytest.approx(-expected / math.tan(angle), rel=2e-3)


def test_a_heap_on_the_wedge_weighs_as_in_the_force_polygon():
    area, slope = 0.01, math.tan(SOIL.repose_angle)
    length = math.sqrt(2 * area / slope)

    def weight(reach):
        left = max(length - reach, 0.0)
        return SOIL.unit_weight * SOIL.width * (area - 0.5 * slope * left**2)

    expected = draft_force(
        0.05, SOIL.width, 1.5, SOIL.friction_angle, SOIL.wall_angle, SOIL.unit_weight, weight
    )
    assert earthmoving.cutting_force(0.05, 1.5, area, SOIL)[:, 0].sum() == pytest.approx(
        expected, rel=2e-3
    )


def test_a_wide_smooth_upright_wall_bears_rankines_passive_pressure():
    """gamma d2 / 2 tan2(45 + phi / 2) per metre of width."""
    phi = 0.55
    soil = dataclasses.replace(SOIL, friction_angle=phi, wall_angle=0.0, width=1e6)
    found = earthmoving.cutting_force(0.3, math.pi / 2, 0.0, soil).sum(axis=0)[0] / soil.width
    expected = 0.5 * soil.unit_weight * 0.3**2 * math.tan(math.pi / 4 + phi / 2) ** 2
    assert found == pytest.approx(expected, rel=1e-3)


def test_the_blade_is_that_of_the_solver():
    assert earthmoving.BLADE_FRICTION == bodies.BLADE_FRICTION
