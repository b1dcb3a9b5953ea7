"""A tool on a terrain, frame by frame; its forces are held in `test_training` against the law of a
soil, in `test_shipped_fields` against turned scenes and earlier trenches, and against C."""

import numpy as np
import pytest

from learning_to_simulate.soil_field.stepper import SoilStepper
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Wheel
from tests.learning_to_simulate.soil_field import worlds
from tests.learning_to_simulate.soil_field.scenes import poses


def stepper(terrain=None, **more):
    terrain = terrain or Terrain.flat((3.0, 4.0), corner=(-2.0, -2.0))
    return SoilStepper(worlds.trained()[0], terrain, worlds.TOOL, **more)


@pytest.mark.parametrize('engine', ['best', 'tensorflow'])
def test_soil_rests_no_steeper_than_its_angle_of_repose_where_the_tool_has_gone(engine):
    ground = Terrain.flat((3.0, 2.0), corner=(-2.5, -1.0))
    tool = stepper(ground, engine=engine)
    tool.start(poses([[0.0, 0.1, 0.1]])[0])
    for u in np.arange(0.0, 1.5, 0.05):
        tool.step(poses([[u, -0.04, 0.1]])[0], 0.1)
    steep, litres = np.abs(np.diff(ground.heights, axis=1)), ground.heights.sum()
    behind = ground.middles[0] > -0.4  # the bins have left it
    assert steep[behind].max() / 0.02 < ground.soil.friction + 0.005 < steep.max() / 0.02
    tool.start(poses([[1.5, 0.3, 0.1]])[0])
    slope = np.abs(np.diff(ground.heights, axis=1)).max() / 0.02
    assert slope < ground.soil.friction + 0.005
    assert ground.heights.sum() == pytest.approx(litres, abs=1e-9)


def test_what_a_field_does_not_have_is_refused():
    """Poses and times are refused in `native/test_soil_engine`, in the words of both engines."""
    with pytest.raises(ValueError, match='knows a blade, not a wheel'):
        SoilStepper(worlds.trained()[0], Terrain.flat((1.0, 1.0)), Wheel())
    for members in (3, 1.5):
        with pytest.raises(ValueError, match=rf'members is {members}, must lie in \[1, 2\]'):
            stepper(members=members)
    with pytest.raises(AttributeError):
        stepper().terrain = Terrain.flat((1.0, 1.0))
    tool, pose = stepper(), poses([[0.0, 0.2, 0.1]])[0]
    tool.start(pose)
    with pytest.raises(ValueError, match='dt is soon s'):
        tool.step(pose, dt='soon')
