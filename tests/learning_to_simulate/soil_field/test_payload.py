"""What a bucket holds, against the shape that the solver has and areas counted by points."""

import numpy as np
import pytest
from matplotlib.path import Path

from learning_to_simulate.soil_field import payload
from mpm.motions import operator_paths


def inner(radius):
    """Edge and inside of the solver's bucket, up to its rim [9, 2]: u along the way, y."""
    outline = np.array(operator_paths.bucket(radius, 0.3, False)['outline']) * [-1.0, 1.0]
    return np.concatenate([outline[:1], outline[payload.INSIDE.shape[0] - 1 : -1][::-1]])


@pytest.mark.parametrize('radius', [0.08, 0.15])
def test_the_inside_is_that_of_the_bucket_of_the_solver(radius):
    height = max(y for _, y in operator_paths.bucket(radius, 0.3, False)['outline'])
    assert payload.radius(height) == pytest.approx(radius, abs=1e-4)
    np.testing.assert_allclose(inner(radius), radius * payload.INSIDE[:-1], atol=2e-5)


@pytest.mark.parametrize('lean', [-0.03, 0.3, 0.9, 1.5])
@pytest.mark.parametrize('friction', [0.5, 0.9])
def test_room_and_its_middle_are_those_of_points_below_both_slopes(lean, friction):
    radius, rng = 0.1, np.random.default_rng(0)
    turn = np.array([[np.cos(lean), np.sin(lean)], [-np.sin(lean), np.cos(lean)]])
    corners = radius * payload.INSIDE @ turn
    low, high = corners.min(axis=0), corners.max(axis=0)
    points = rng.uniform(low, high, (200_000, 2))
    edge, rim = corners[0], corners[-2]
    way = np.sign(rim[0] - edge[0])
    inside = Path(corners).contains_points(points)
    for through, rises in ((edge, way), (rim, -way)):
        inside &= points[:, 1] <= through[1] + friction * rises * (points[:, 0] - through[0])
    area, middle, _ = payload.room(payload.SHELL + payload.BACK_HEIGHT * radius, lean, friction)
    assert area == pytest.approx(inside.mean() * np.prod(high - low), rel=0.03)
    assert middle == pytest.approx(points[inside, 0].mean(), abs=1e-3)


def test_soil_slips_out_where_the_floor_is_steep():
    leans = np.linspace(-0.3, 0.3, 61)
    rooms = np.array([payload.room(0.25, lean, 0.76)[0] for lean in leans])
    assert (rooms[leans < payload.SLIPS - payload.SLIPS_OUT] == 0).all()
    assert (np.diff(rooms) >= 0).all() and rooms[-1] > 0.01
    assert payload.room(payload.SHELL / 2, 0.2, 0.76)[0] == 0  # all shell
    kept = [payload.kept(lean) for lean in (-1.0, np.mean(payload.CURLED), 2.0)]
    np.testing.assert_allclose(kept, [0.53, 0.74, 0.95])


def test_pictures_show_it_on_the_floor_as_high_as_its_area():
    lean, area = 0.5, 0.008
    places = payload.places(0.25, lean, 0.76, area, 4000)
    turn = np.array([[np.cos(lean), np.sin(lean)], [-np.sin(lean), np.cos(lean)]])
    corners = payload.radius(0.25) * payload.INSIDE[:-1] @ turn
    wider = 1.01 * corners - 0.01 * corners.mean(axis=0)
    assert Path(wider).contains_points(places).mean() > 0.99
    cells = np.unique(np.floor(places / 0.004), axis=0)
    assert len(cells) * 0.004**2 == pytest.approx(area, rel=0.2)
    assert len(payload.places(0.25, lean, 0.76, area, 0)) == 0
