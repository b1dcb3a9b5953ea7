"""Scale, turns and values of tools, and values that none has."""

import json

import numpy as np
import pytest

from learning_to_simulate.soil_field.tools import (
    FLOOR_DEG,
    FLOOR_SHARE,
    Blade,
    Soil,
    Wheel,
    read_tool,
    tool_as,
)
from mpm.motions.operator_paths import BUCKET_RADII, bucket, underside


def test_a_blade_as_wide_as_those_taught_is_its_own_scale():
    assert [Blade(w).scale for w in (0.15, 0.4, 0.6)] == [1, 1, 1]
    assert Blade(1.2).scale == pytest.approx(2.0) and Blade(0.05).scale == pytest.approx(1 / 3)
    assert Wheel(0.2, 0.25).scale == pytest.approx(2.5)


@pytest.mark.parametrize('factor', [2.0, 5.0])
def test_tools_of_one_form_are_one_tool_of_the_field(factor):
    soil = Soil(33.0)
    blade = Blade(0.6, 0.012, 0.3, 1.0, 1.0), Blade(*factor * np.array([0.6, 0.012, 0.3]), 1.0, 1.0)
    wheel = Wheel(0.1, 0.1, 12, 0.01), Wheel(factor * 0.1, factor * 0.1, 12, factor * 0.01)
    for one, other in (blade, wheel):
        # Grains as stiff against the soil's weight.
        as_stiff = Soil(33.0, gravity=soil.gravity / factor)
        np.testing.assert_allclose(other.values(as_stiff), one.values(soil), atol=1e-12)
        named = dict(zip(one.scalars, one.values(soil)))
        assert named['half_width'] == one.width / 2 and named['radius'] == one.radius
        assert named['friction'] == pytest.approx(np.tan(np.radians(33.0)))
        assert len(one.scalars) == len(one.values(soil))
    assert dict(zip(Blade.scalars, blade[0].values(soil)))['length'] == 0.3
    assert dict(zip(Wheel.scalars, wheel[0].values(soil)))['lug_height'] == 0.01
    heavy = dict(zip(Wheel.scalars, wheel[1].values(Soil(density=2 * soil.density))))
    assert heavy['stress'] == pytest.approx(np.log(2 * factor))


def test_turns():
    """A wheel that rolls forward without slip leans forward by the way over its radius."""
    assert Wheel(0.2, 0.25).turn(np.array([0.03, 0.0, -0.3])) == pytest.approx(0.0)
    assert Wheel(0.2, 0.25).turn(np.array([0.0, 0.0, -0.3])) == pytest.approx(0.03)
    assert Blade().turn(np.array([0.5, 0.1, 0.2])) == pytest.approx(0.02)


@pytest.mark.parametrize(
    'kind, values',
    [
        (Soil, {'friction_angle_deg': 90.0}), (Soil, {'density': 0.0}),
        (Soil, {'gravity': np.nan}), (Blade, {'width': -1.0}), (Blade, {'radius': np.inf}),
        (Blade, {'length': 0.0}), (Blade, {'bucket': 0.5}), (Blade, {'floor_deg': 90.0}),
        (Blade, {'floor_share': 0.0}), (Wheel, {'radius': 0.0}), (Wheel, {'lugs': -1}),
        (Wheel, {'lug_height': np.nan}), (Blade, {'width': 'wide'}),
    ],
)  # fmt: skip
def test_values_that_nothing_has_are_refused(kind, values):
    with pytest.raises(ValueError, match=next(iter(values))):
        kind(**values)


def test_the_back_of_a_plate_is_its_middle_line_and_of_a_bucket_its_floor():
    angle, length = Blade(0.3, radius=0.01, length=0.25).back(np.radians(25.0))
    assert (np.degrees(angle), length) == pytest.approx((65.0, 0.23))
    assert Blade().back(0.0)[0] == Blade().back(-0.3)[0] == np.pi / 2  # it stands on its edge
    assert Blade(1.2, radius=0.04, length=0.6).back(0.0)[1] == pytest.approx(0.26)  # of the field
    assert Wheel().back(1.0) == (0.0, 0.0)
    lean = np.radians(-20.0)
    for shape in ({}, {'floor': 0.15, 'rise_deg': 30.0, 'arc_deg': 140.0}):
        for inner in BUCKET_RADII:
            made = bucket(inner, 0.4, False, **shape)
            floor = np.array(made['outline'])[1]
            tool = tool_as(made)
            assert tool.floor_deg == pytest.approx(underside(made))  # as the solver draws paths
            angle, length = tool.back(lean)
            assert angle == pytest.approx(np.arctan2(floor[1], floor[0]) - lean)
            assert length == pytest.approx(np.hypot(*floor) - 0.008)
            if not shape:  # what is usual
                assert tool.floor_deg == pytest.approx(FLOOR_DEG, abs=3.0)
                assert tool.floor_share == pytest.approx(FLOOR_SHARE, abs=0.05)
    tool = Blade(0.4, bucket=1.0)
    curled = [np.degrees(tool.back(np.radians(lean))[0]) for lean in (20.0, 90.0)]
    assert curled == pytest.approx([-13.0, -60.0])  # its heel is lower than its edge
    assert Blade().back(2.0)[0] == 0.0


def test_a_tool_is_read_from_its_file(tmp_path):
    path = tmp_path / 'tool.json'

    def read(**described):
        path.write_text(json.dumps(described))
        return read_tool(str(path))

    plate = {'outline': [[0.0, 0.0], [0.0, 0.3]], 'edge_radius': 0.01, 'width': 0.4}
    assert read(name='plate', friction=0.3, **plate) == Blade(0.4, 0.01, 0.3)
    # A face that leans forward has nothing behind its edge.
    ahead = plate | {'outline': [[0.0, 0.0], [0.0, 0.3], [-0.1, 0.2]]}
    assert read(**ahead) == Blade(0.4, 0.01, 0.3, 1.0)
    grousers = {'count': 12, 'height': 0.01, 'thickness': 0.004}
    assert read(radius=0.15, width=0.12, grousers=grousers) == Wheel(0.12, 0.15, 12, 0.01)
    made = bucket(0.1, 0.3, True)
    assert read(**made) == tool_as(made) and read(**made).plates == 1
    bad = plate | {'outline': [0.0, 1.0]}, {'width': 0.3}, plate | {'width': -1.0}
    for described in (*bad, {'radius': 'wide', 'width': 1.0}):
        with pytest.raises(ValueError, match=f'{path} is not a tool: .* mpm/README.md'):
            read(**described)
