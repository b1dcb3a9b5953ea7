"""Drives of the wheel: within their limits, and of their kind."""

from mpm import scenes
from mpm.motions import catalogue

SCENE = scenes.WHEEL


def test_a_tool_of_ones_own_takes_the_place_of_the_grid_s():
    tool = {'name': 'mine', 'radius': 0.11, 'width': 0.09, 'friction': 0.4}
    motion = catalogue.motion_of(SCENE, 'slip_0002', tool)
    assert motion.drive.body.radius == 0.11 and motion.parameters['tool'] == tool
    assert motion.parameters['diameter_m'] == 0.22
