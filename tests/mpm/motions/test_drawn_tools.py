"""Tools drawn from a seed: blades and buckets that are what they say."""

import math

import numpy as np
import pytest

from mpm import bodies
from mpm.motions import drawn_tools


@pytest.mark.parametrize('radius', drawn_tools.BUCKET_RADII)
@pytest.mark.parametrize('has_plates', [True, False])
def test_a_bucket_is_hollow_and_open_to_the_front(radius, has_plates):
    body = bodies.tool_body(drawn_tools.bucket(radius, 0.6, has_plates))
    rise = math.radians(15.0)
    along = np.array([math.cos(rise), math.sin(rise)])
    up = np.array([-math.sin(rise), math.cos(rise)])
    middle = 1.6 * radius * along + radius * up
    back = middle + (radius + 0.5 * drawn_tools.SHELL) * np.array([math.cos(0.2), math.sin(0.2)])
    half = body.half_width

    def distance(place, z=0.0):
        return bodies.signed_distances(body, np.zeros(4), np.array([[*place, z]]))[0]

    # Room for soil: the circle's own radius, less where its back is a polygon.
    assert 0.9 * radius < distance(middle) + 0.004 < 1.001 * radius
    assert distance(back) < -0.3 * drawn_tools.SHELL
    assert distance(middle - [2.0 * radius, 0.0]) > 0.3 * radius  # nothing in front of it
    # What closes its ends is as thick as a plate, and there only.
    in_plate = distance(middle, half - 0.5 * drawn_tools.PLATE)
    assert in_plate == pytest.approx(-0.5 * drawn_tools.PLATE) if has_plates else in_plate > 0.05
    assert distance([0.0, 0.0]) < 0.0 < distance([-0.006, 0.0])  # the edge is the reference point
