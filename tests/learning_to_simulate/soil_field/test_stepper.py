"""A tool on a terrain, frame by frame."""

import numpy as np
import pytest

from learning_to_simulate.live.poses import turned
from learning_to_simulate.soil_field import network
from learning_to_simulate.soil_field.place import place_of
from learning_to_simulate.soil_field.stepper import SoilStepper
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Wheel
from tests.learning_to_simulate.soil_field import worlds
from tests.learning_to_simulate.soil_field.scenes import DT, poses

IN_AIR = [0.0, 0.2, 0.1]
AWAY = (0.0, 0.0, 1.2)  # from what was cut before
END = worlds.path(3)[-1]


def stepper(terrain=None, **more):
    terrain = terrain or Terrain.flat((3.0, 4.0), corner=(-2.0, -2.0))
    return SoilStepper(worlds.trained()[0], terrain, worlds.TOOL, **more)


def driven(tool, **more):
    """Frames along a path of `worlds`."""
    way = poses(worlds.path(3), **more)
    return [tool.start(way[0])] + [tool.step(pose) for pose in way[1:]]


def test_forces_are_those_of_the_soil_and_turn_with_the_scene():
    here, there = stepper(), stepper(Terrain.flat((8.0, 8.0), 0.4, corner=(-4.0, -4.0)))
    found, shift = driven(here), (0.3, 0.4, -0.2)
    depth = np.maximum(worlds.TOOL.radius - worlds.path(3)[:, 1], 0.0)
    truth = depth[:, None] * [6000.0, 2000.0, 0.0]
    force = np.array([frame.force for frame in found])
    assert np.linalg.norm(force - truth) < 0.25 * np.linalg.norm(truth)
    assert found[-1].status == 'ok'
    place = place_of(poses(worlds.path(3), yaw=2.1)[0])
    for one, other in zip(found, driven(there, yaw=2.1, shift=shift), strict=True):
        local = [-one.force[0], one.force[1], -one.force[2]]
        np.testing.assert_allclose(place.vectors(local), other.force, atol=2e-3)
        local = [-one.torque[0], one.torque[1], -one.torque[2]]
        np.testing.assert_allclose(place.vectors(local), other.torque, atol=2e-4)


def test_the_next_tool_meets_what_the_last_has_left():
    terrain = Terrain.flat((3.0, 2.0), corner=(-2.0, -1.0))
    one, other = stepper(terrain), stepper(terrain)
    first = np.array([frame.force for frame in driven(one)])
    assert terrain.heights.min() < -0.01
    again = np.array([frame.force for frame in driven(other)])
    aside = np.array([frame.force for frame in driven(stepper(terrain), shift=(0, 0, 0.68))])
    assert np.linalg.norm(again - first) > 0.1 * np.linalg.norm(first)
    np.testing.assert_allclose(aside, first, atol=0.02 * np.abs(first).max())


def test_yaw_in_the_soil_is_flagged_and_free_in_the_air():
    tool = stepper()
    driven(tool)
    place = tool.place
    frame = tool.step(poses([IN_AIR])[0], dt=0.5)
    assert not frame.force.any() and frame.now.status == 'ok'
    turn = poses([IN_AIR], yaw=0.8, shift=AWAY)[0]
    frame = tool.step(turn, dt=0.5)
    assert frame.now.status == 'ok' and tool.place is not place
    np.testing.assert_allclose(tool.place.turns(turn)[1:], 0.0, atol=1e-12)
    down = poses([[0.0, worlds.TOOL.radius - 0.03, 0.1]], yaw=0.8, shift=AWAY)[0]
    frame = tool.step(down, dt=0.5)
    assert frame.force.any()
    yawed = np.append(down[:3], turned(down[3:], [0.0, 0.2, 0.0]))
    frame = tool.step(yawed, dt=DT)
    assert frame.status == 'extrapolating' and 'yaw' in frame.reason


def test_a_tool_clear_of_its_heap_bears_nothing_and_goes_where_it_likes():
    tool = stepper(engine='tensorflow')
    driven(tool)
    place, (u, _, lean) = tool.place, END
    up = [u, worlds.TOOL.radius + worlds.HEAP + network.ABOVE + network.RAMP + 0.006, lean]
    # As far as the network of the load knows, a heap may stand higher.
    kappa = tool.field.networks.load_inputs
    frame = tool.step(poses([up])[0], dt=0.5)
    passage = tool._engine._passage
    assert float(kappa(*passage.frame)[2].numpy().max()) == 1
    assert not (frame.force.any() or frame.torque.any() or frame.spread.any())
    assert frame.now.status == 'ok'
    aside = tool.step(poses([up], shift=(0.0, 0.0, 0.04))[0], dt=0.5)
    assert aside.now.status == 'ok' and tool.place is not place
    # Within its heap it bears a load, and none of it comes at once.
    low = stepper(engine='tensorflow')
    driven(low)
    shares = []
    for height in np.linspace(0.0, up[1], 40):
        frame = low.step(poses([[u, height, lean]])[0], dt=0.5)
        bears = frame.force.any()  # else the passage may be another
        shares.append(low.field.contact(low._engine._passage) if bears else 0.0)
    assert shares[0] == 1 and shares[-1] == 0 and np.diff(shares).max() <= 0
    assert ((np.array(shares) > 0) & (np.array(shares) < 1)).sum() >= 2


@pytest.mark.parametrize('engine', ['c', 'tensorflow'])
def test_looking_at_the_terrain_changes_nothing_where_two_tools_reach_each_other(engine):
    ground, way = Terrain.flat((3.0, 2.0), corner=(-1.5, -1.0)), worlds.path(3)
    tools = [stepper(ground, engine=engine) for _ in range(2)]
    for pose in poses(way):
        for k, tool in enumerate(tools):
            there = pose + [0.0, 0.0, 0.35 * k, 0.0, 0.0, 0.0, 0.0]
            tool.start(there) if tool._frame is None else tool.step(there)
    seen = [ground.heights.copy() for _ in range(3)]
    assert seen[0].min() < -0.01
    np.testing.assert_array_equal(seen[1], seen[0])
    np.testing.assert_array_equal(seen[2], seen[0])


def test_soil_rests_no_steeper_than_its_angle_of_repose_where_the_tool_has_gone():
    ground = Terrain.flat((3.0, 2.0), corner=(-2.5, -1.0))
    tool = stepper(ground)
    tool.start(poses([[0.0, 0.1, 0.1]])[0])
    for u in np.arange(0.0, 1.5, 0.05):
        tool.step(poses([[u, -0.04, 0.1]])[0], 0.1)
    steep, litres = np.abs(np.diff(ground.heights, axis=1)).max(), ground.heights.sum()
    tool.start(poses([[1.5, 0.3, 0.1]])[0])
    slope = np.abs(np.diff(ground.heights, axis=1)).max() / 0.02
    assert slope < ground.soil.friction + 0.005 < steep / 0.02
    assert ground.heights.sum() == pytest.approx(litres, abs=1e-9)


def test_what_a_field_does_not_have_is_refused():
    """Poses and times are refused in `native/test_soil_engine`, in the words of both engines."""
    with pytest.raises(ValueError, match='knows a blade, not a wheel'):
        SoilStepper(worlds.trained()[0], Terrain.flat((1.0, 1.0)), Wheel())
    with pytest.raises(ValueError, match=r'members is 3, must lie in \[1, 2\]'):
        stepper(members=3)
