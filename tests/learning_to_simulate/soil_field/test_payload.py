"""What a bucket holds, against the shape that the solver has and areas counted by points."""

import numpy as np
import pytest
from matplotlib.path import Path

from learning_to_simulate.soil_field import payload
from learning_to_simulate.soil_field.tools import tool_as
from mpm.motions import operator_paths

SHAPES = [{}, {'floor': 0.12, 'rise_deg': 30.0}, {'floor': 0.25, 'rise_deg': 5.0}]
USUAL = payload.Shape(0.25, np.radians(7.0), 0.15)


@pytest.mark.parametrize('radius', [0.08, 0.15])
@pytest.mark.parametrize('given', SHAPES)
def test_the_inside_is_that_of_the_bucket_of_the_solver(radius, given):
    made = operator_paths.bucket(radius, 0.3, False, **given)
    shape, outline = tool_as(made).shape, np.array(made['outline']) * [-1.0, 1.0]
    inner = np.concatenate([outline[:1], outline[9:-1][::-1]])  # edge and inside, up to its rim
    near = 0.005 if given else 2e-5  # the highest corner of an arc may lie lower than the arc
    np.testing.assert_allclose(inner, shape.inside[:-1], atol=near)
    assert shape.reach == pytest.approx(-inner[:, 0].min(), abs=near)


@pytest.mark.parametrize('given', SHAPES)
@pytest.mark.parametrize('lean', [-0.03, 0.3, 0.9, 1.5])
@pytest.mark.parametrize('friction', [0.5, 0.9])
def test_room_and_its_middle_are_those_of_points_below_both_slopes(lean, friction, given):
    made, rng = operator_paths.bucket(0.1, 0.3, False, **given), np.random.default_rng(0)
    shape = tool_as(made).shape
    turn = np.array([[np.cos(lean), np.sin(lean)], [-np.sin(lean), np.cos(lean)]])
    corners = shape.inside @ turn
    low, high = corners.min(axis=0), corners.max(axis=0)
    points = rng.uniform(low, high, (200_000, 2))
    edge, rim = corners[0], corners[-2]
    way = np.sign(rim[0] - edge[0])
    inside = Path(corners).contains_points(points)
    for through, rises in ((edge, way), (rim, -way)):
        inside &= points[:, 1] <= through[1] + friction * rises * (points[:, 0] - through[0])
    area, middle, holds = payload.room(shape, lean, friction)
    # How steeply the floor rises where it is 17 deg and where it is 25: all, and nothing.
    assert holds == pytest.approx(np.clip((25 - np.degrees(shape.slope - lean)) / 8, 0, 1))
    counted = inside.mean() * np.prod(high - low)
    assert area == pytest.approx(holds * counted, rel=0.03, abs=1e-5)
    assert middle == pytest.approx(points[inside, 0].mean() if inside.any() else 0.0, abs=2e-3)


def test_soil_slips_out_where_the_floor_is_steep():
    leans = np.linspace(-0.3, 0.3, 61)
    rooms = np.array([payload.room(USUAL, lean, 0.76)[0] for lean in leans])
    assert (rooms[USUAL.slope - leans > payload.SLIPS + payload.SLIPS_OUT] == 0).all()
    assert (np.diff(rooms) >= 0).all() and rooms[-1] > 0.01
    assert payload.room(payload.Shape(payload.SHELL, 0.0, 0.02), 0.2, 0.76)[0] == 0  # all shell
    falls = (-2.0, np.mean(payload.CURLED), 2.0)
    kept = [payload.kept(USUAL, fall + USUAL.slope) for fall in falls]
    np.testing.assert_allclose(kept, [0.53, 0.74, 0.95])


def test_pictures_show_it_on_the_floor_as_high_as_its_area():
    lean, area = 0.5, 0.008
    places = payload.places(USUAL, lean, 0.76, area, 4000)
    turn = np.array([[np.cos(lean), np.sin(lean)], [-np.sin(lean), np.cos(lean)]])
    corners = USUAL.inside[:-1] @ turn
    wider = 1.01 * corners - 0.01 * corners.mean(axis=0)
    assert Path(wider).contains_points(places).mean() > 0.99
    cells = np.unique(np.floor(places / 0.004), axis=0)
    assert len(cells) * 0.004**2 == pytest.approx(area, rel=0.2)
    assert len(payload.places(USUAL, lean, 0.76, area, 0)) == 0
