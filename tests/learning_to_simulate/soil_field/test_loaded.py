"""Tools under a load, against closed forms in soils that are springs."""

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from learning_to_simulate.soil_field import loaded
from learning_to_simulate.soil_field.loaded import ABOVE_FLOOR, Damping, LoadedTool, root
from learning_to_simulate.soil_field.place import place_of
from tests.learning_to_simulate.soil_field.scenes import poses

MASS, G, DT = 20.0, 9.81, 0.004


class Answer(NamedTuple):
    pose: np.ndarray
    force: np.ndarray
    torque: np.ndarray


class Springs:
    """A stepper whose soil pulls u, y and lean back to 0 with a matrix K."""

    def __init__(self, stiffness=((0.0, 0.0, 0.0),) * 3):
        self.terrain = SimpleNamespace(soil=SimpleNamespace(gravity=G), floor=-1.0)
        self.tool = SimpleNamespace(radius=0.1)
        self.place, self._k = place_of(poses([[0, 0, 0]])[0]), np.asarray(stiffness, float)
        self.frame = self.propose(poses([[0.0, 0.0, 0.0]])[0], DT)

    def propose(self, pose, dt):
        u, y, _ = self.place.local(pose[:3])
        load = -self._k @ [u, y, self.place.turns(pose)[0]]
        vectors = self.place.vectors
        return Answer(pose, vectors([load[0], load[1], 0.0]), vectors([0, 0, load[2]]))

    def step(self, pose, dt):
        self.frame = self.propose(pose, dt)
        return self.frame

    @property
    def coordinates(self):
        u, y, _ = self.place.local(self.frame.pose[:3])
        return np.array([u, y, self.place.turns(self.frame.pose)[0]])


REST = poses([[0.0, 0.0, 0.0]])[0]


def test_it_falls_to_the_floor_where_no_soil_bears_it():
    soil = Springs()
    tool = LoadedTool(soil, MASS)
    for _ in range(25):
        tool.step(REST, dt=DT)
    # Backward Euler: the mean of a step is its end.
    assert soil.coordinates[1] == pytest.approx(-G * DT**2 * 25 * 26 / 2, abs=1e-6)
    assert tool.velocity == pytest.approx([0.0, -G * DT * 25, 0.0], abs=1e-3)
    for _ in range(100):
        tool.step(REST, dt=DT)
    assert soil.coordinates[1] == pytest.approx(-0.9 + ABOVE_FLOOR) and tool.velocity[1] == 0
    tool.step(REST, (0.0, 2 * MASS * G, 0.0), dt=DT)
    assert soil.coordinates[1] > -0.9 + 2 * ABOVE_FLOOR
    tool.step(REST, (0.0, -9 * MASS * G, 0.0), dt=DT)  # it still rises; and is pressed back
    assert soil.coordinates[1] == pytest.approx(-0.9 + ABOVE_FLOOR)


def test_coupled_coordinates_solve_the_whole_system():
    soil_k = np.array([[2e5, 1.8e5, 300.0], [-1e5, 2.2e5, -200.0], [400.0, 100.0, 4e3]])
    springs, dampers = np.array([2e4, 1e4, 500.0]), np.array([2e3, 1e3, 50.0])
    soil, inertia, force = Springs(soil_k), 0.4, np.array([30.0, -10.0, 0.0])
    tool = LoadedTool(soil, MASS, inertia, ('along', 'up', 'lean'), springs, dampers)
    target = poses([[0.02, 0.01, 0.05]])[0]
    mass = np.diag([MASS, MASS, inertia])
    q, v = np.zeros(3), np.zeros(3)
    outer = np.array([-30.0, -10.0 - MASS * G, 2.0])  # along is -x
    for _ in range(5):
        tool.step(target, force, torque=2.0, dt=DT)
        left = mass / DT**2 + soil_k + np.diag(springs) + np.diag(dampers) / DT
        right = mass @ (q / DT**2 + v / DT) + outer + springs * [0.02, 0.01, 0.05]
        new = np.linalg.solve(left, right + dampers / DT * q)
        v, q = (new - q) / DT, new
        np.testing.assert_allclose(soil.coordinates, q, atol=2e-6)


def test_a_spring_of_the_lean_sees_no_whole_turn():
    soil, leans = Springs(), []
    tool = LoadedTool(soil, MASS, 1.0, ('lean',), (0.0, 0.0, 400.0), (0.0, 0.0, 40.0))
    for lean in 0.1 * np.arange(1, 81):
        tool.step(poses([[0.0, 0.0, lean]])[0], dt=0.05)
        leans.append(soil.coordinates[2])
    turned = np.unwrap(leans)
    assert (np.diff(turned) > 0).all()
    # At 2 rad/s the damper pulls back by 80 N m, so the spring is 0.2 rad long.
    assert turned[-1] == pytest.approx(8.0 - 0.2, abs=0.01)


def test_what_is_not_free_follows_the_pose():
    soil = Springs(np.diag([1e4, 1e5, 1e3]))
    tool = LoadedTool(soil, MASS, free=('up',))
    tool.step(poses([[0.03, 0.2, 0.1]])[0], dt=DT)
    assert soil.coordinates[[0, 2]] == pytest.approx([0.03, 0.1]) and soil.coordinates[1] < 0


@pytest.mark.parametrize(
    'changes, message',
    [
        ({'free': ()}, 'free is'), ({'free': ('sideways',)}, 'free is'), ({'mass': 0.0}, 'mass'),
        ({'mass': np.inf}, 'mass'), ({'free': ('lean',)}, 'inertia'),
        ({'stiffness': (1.0, -1.0, 0.0)}, 'stiffness'), ({'damping': (1.0,)}, 'damping'),
    ],
)  # fmt: skip
def test_bad_bodies_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        LoadedTool(Springs(), **({'mass': MASS} | changes))


def test_a_root_is_found_across_a_kink_and_none_is_said():
    found = root(lambda x: x - 3e-3 + (200.0 if x > 1e-3 else 0.0) * (x - 1e-3), 0.5, 1e-5, 1e-9)
    assert found == pytest.approx((3e-3 + 0.2) / 201.0, abs=1e-8)
    assert root(lambda x: x, 0.0, 1e-5, 1e-9) == pytest.approx(0.0, abs=1e-8)
    with pytest.raises(ValueError, match='no pose holds the load'):
        root(lambda x: 1.0, 0.0, 1e-5, 1e-9)


class Lagging(Springs):
    """Soil whose force follows a spring late: left alone, a load on it swings ever higher."""

    late = 0.0

    def propose(self, pose, dt):
        found = super().propose(pose, dt)
        force = 0.2 * found.force + 0.8 * np.array([0.0, max(self.late, 0.0), 0.0])
        return found._replace(force=np.maximum(force, 0.0))

    def step(self, pose, dt):
        frame = super().step(pose, dt)
        self.late += 0.3 * (super().propose(pose, dt).force[1] - self.late)
        return frame


def test_soil_that_answers_late_does_not_throw_a_tool_back(monkeypatch):
    def swing():
        soil = Lagging(np.diag([0.0, 5e4, 0.0]))
        tool, heights = LoadedTool(soil, MASS), []
        for _ in range(300):
            tool.step(REST, dt=DT)
            heights.append(soil.coordinates[1])
        return np.ptp(heights[-100:])

    assert swing() < 1e-5
    monkeypatch.setattr(loaded, 'UNLOADS', 1e9)  # nothing damps it
    assert swing() > 1e-2


def test_it_sinks_as_fast_as_its_weight_takes_it_and_hardly_swings_back(monkeypatch):
    def fall():
        soil = Springs(np.diag([0.0, 2e5, 0.0]))
        tool, heights = LoadedTool(soil, MASS), []
        for _ in range(400):
            tool.step(REST, dt=DT / 16)
            heights.append(soil.coordinates[1])
        return np.array(heights)

    damped = fall()
    monkeypatch.setattr(loaded, 'UNLOADS', 1e9)
    free = fall()
    lowest = int(free.argmin())
    assert 100 < lowest < 150 and free[lowest] < -1.5 * MASS * G / 2e5
    np.testing.assert_allclose(damped[: lowest + 1], free[: lowest + 1], atol=1e-7)
    rest = -MASS * G / 2e5
    assert damped[lowest:].max() < 0.9 * rest < 0.2 * rest < free[lowest:].max()


def test_what_moves_evenly_is_not_damped_and_the_force_is_that_of_the_balance():
    soil = Springs(np.diag([0.0, 2e5, 0.0]))
    tool = LoadedTool(soil, MASS)
    speed, sinks = 0.03, MASS * G / 2e5
    pull = np.zeros(3)
    for t in range(600):
        before = tool.velocity[1]
        pull[1] = -2e5 * speed * DT * t  # a load that grows
        frame = tool.step(REST, pull, dt=DT)
        balance = frame.force[1] + pull[1] - MASS * G - MASS * (tool.velocity[1] - before) / DT
        assert balance == pytest.approx(0.0, abs=0.1)
    assert tool.velocity[1] == pytest.approx(-speed, rel=1e-3)
    assert soil.coordinates[1] == pytest.approx(-sinks - speed * DT * 599, abs=1e-5)


def test_what_the_machine_holds_is_not_damped():
    damping = Damping()
    damping.press(20.0, 196.2)
    critical = 2.0 * np.sqrt(20.0 * 196.2 / 0.002)
    assert damping.coefficient == pytest.approx(critical)
    assert damping.force(150.0, 0.01) == pytest.approx(-0.01 * critical)
    assert damping.force(150.0, 1.0) == -150.0
    assert damping.force(150.0, -1.0) == damping.force(-3.0, 1.0) == 0.0  # sinks; is pulled
    for share, held in (
        (0.5, {'stiffness': 196.2 / 0.002 / 8}), (0.5, {'damping': critical / 8}),
        (0.5, {'held': 196.2 / 8}), (0.0, {'stiffness': 1e5, 'damping': 1e3}), (0.0, {'held': 60}),
    ):  # fmt: skip
        damping.press(20.0, 196.2, **held)
        assert damping.coefficient == pytest.approx(share * critical)
    damping.press(20.0, -5.0)  # pulled up
    assert damping.coefficient == 0.0


@pytest.mark.parametrize(
    'given, message',
    [
        ({'force': (0.0, np.nan, 0.0)}, 'force is'), ({'force': (0.0, 1.0)}, 'force is'),
        ({'force': 5.0}, 'force is'), ({'torque': np.nan}, 'torque nan'),
        ({'dt': np.nan}, 'dt is nan s'), ({'dt': 0.0}, 'dt is 0.0 s'),
    ],
)  # fmt: skip
def test_loads_and_times_that_cannot_be_are_refused_and_change_nothing(given, message):
    soil = Springs(np.diag([0.0, 2e5, 0.0]))
    tool, twin = LoadedTool(soil, MASS), LoadedTool(other := Springs(soil._k), MASS)
    for one in (tool, twin):
        one.step(REST, dt=DT)
    with pytest.raises(ValueError, match=message):
        tool.step(REST, **({'dt': DT} | given))
    for one in (tool, twin):
        one.step(REST, dt=DT)
    np.testing.assert_array_equal(soil.coordinates, other.coordinates)
