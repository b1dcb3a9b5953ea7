"""Particles about a tool: where they stand, that they go with the soil and never jump."""

import numpy as np
import pytest

from learning_to_simulate.soil_field.stepper import SoilStepper
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tracer import LAYERS, SPACING, Tracer
from tests.learning_to_simulate.soil_field import worlds
from tests.learning_to_simulate.soil_field.scenes import poses

LONG = np.stack(
    [np.linspace(0.0, 0.9, 91), np.full(91, worlds.TOOL.radius - 0.03), np.full(91, 0.1)], axis=1
)


@pytest.fixture
def tool():
    terrain = Terrain.flat((3.0, 2.0), corner=(-2.0, -1.0))
    made = SoilStepper(worlds.trained()[0], terrain, worlds.TOOL)
    made.start(poses([[0.0, 0.1, 0.1]])[0])
    return made


def test_they_fill_the_soil_about_the_tool(tool):
    points = tool.particles()
    volume = 1.2 * (worlds.TOOL.width + 0.6) * LAYERS * SPACING  # 0.45 behind to 0.75 ahead
    assert len(points) * SPACING**3 == pytest.approx(volume, rel=0.1)
    assert points[:, 1].max() == pytest.approx(-SPACING / 2)
    assert points[:, 1].min() == pytest.approx(-(LAYERS - 0.5) * SPACING)
    assert len(np.unique(points, axis=0)) == len(points)


def test_they_move_as_the_soil_does_and_rest_far_from_it(tool):
    before = tool.particles()
    for pose in poses(worlds.path(3)):
        tool.step(pose, dt=0.05)
    after = tool.particles()
    assert (tool.clone().particles() == after).all()
    moved = after - before
    depth = (worlds.TOOL.radius - worlds.path(3)[:, 1]).max()
    inside = (np.abs(before[:, 2]) < 0.1) & (before[:, 1] > -depth / 2)
    inside &= (before[:, 0] < -0.08) & (before[:, 0] > -worlds.path(3)[-1, 0] + 0.08)
    assert inside.sum() > 20
    np.testing.assert_allclose(moved[inside].mean(axis=0), [-0.02, 0.01, 0.0], atol=0.006)
    far = np.abs(before[:, 2]) > worlds.TOOL.width / 2 + 0.305
    assert (moved[far] == 0).all() and (moved[before[:, 1] < -0.14] == 0).all()


def test_a_long_way_keeps_them_about_the_tool_without_a_jump(tool, monkeypatch):
    anchors, begin = [], Tracer._anchor

    def anchor(self):
        before = self._rest.astype(np.float32)
        begin(self)
        after = self.points()
        kept = np.isin(after.view('f4,f4,f4'), before.view('f4,f4,f4')).mean()
        anchors.append((len(before), len(after), kept))

    path = poses(LONG)
    tool.step(path[0], dt=0.5)
    tool.particles()
    monkeypatch.setattr(Tracer, '_anchor', anchor)
    for pose in path[1:]:
        tool.step(pose)
    # Three times on the way: what was there is there still, the rest is new.
    assert len(anchors) == 3 and all(0.6 < kept < 0.9 for *_, kept in anchors)
    assert all(abs(n / m - 1) < 0.1 for n, m, _ in anchors)
    points = tool.particles()
    along = -points[:, 0] - LONG[-1, 0]
    assert -0.8 < along.min() < -0.4 and 0.4 < along.max() < 0.8 and np.isfinite(points).all()
