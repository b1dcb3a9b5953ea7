"""Figures of machines against closed forms; the machine of a run as MuJoCo has it."""

import numpy as np
import pytest

from learning_to_simulate.baselines import wheel_terramechanics as terramechanics
from learning_to_simulate.soil_field.runs import Machine, Run
from learning_to_simulate.soil_field.tools import Blade, Soil, Wheel
from reports import machines

T, DT = 120, 1.0 / 60.0


def run_of(free, stiffness=0.0, load=0.0, lean=0.0):
    pose = np.zeros((T, 7))
    pose[:, :3] = [0.5, 0.26, 0.4]
    pose[:, 3], pose[:, 6] = np.cos(lean / 2), np.sin(lean / 2)
    external = np.zeros((T, 6))
    external[:, 1] = load
    machine = Machine(
        10.0, 0.0, free, np.array([stiffness, stiffness, 0.0]), np.array([500.0, 500.0, 0.0]),
        pose.copy(), external,
    )  # fmt: skip
    zero = np.zeros((T, 3))
    return Run(
        'a', 'free', 'test', Blade(width=0.3), Soil(), pose, zero, zero,
        np.full((1, 40, 30), 0.25), T, np.zeros(2), np.full(2, 0.02), None, DT, machine,
    )  # fmt: skip


def test_a_weight_rests_on_the_spring_ground_where_hooke_says():
    pytest.importorskip('mujoco')
    run = run_of((False, True, False), load=-100.0, lean=-0.3)
    found, status = machines.simulate(run, 'spring', None)
    expected = 0.25 + run.tool.radius - 100.0 / machines.STIFFNESS
    assert status is None and found[-1, 1] == pytest.approx(expected, abs=1e-5)
    assert found[-1, 3] == pytest.approx(100.0, rel=1e-3) and found[-1, 0] == 0.5


def test_springs_of_a_machine_pull_to_their_target():
    """Along and up stay level although the tool leans; nothing is in its way."""
    pytest.importorskip('mujoco')
    run = run_of((True, True, False), stiffness=2e4, lean=-0.5)
    run.pose[:, 1] = 0.5
    run.machine.target[:, :2] = [0.4, 0.55]
    found, _ = machines.simulate(run, 'spring', None)
    np.testing.assert_allclose(found[-1], [0.4, 0.55, 0.0, 0.0], atol=1e-3)


def rolling(load, spin):
    """A wheel that turns in its place under a load."""
    run = run_of((False, True, False), load=-load)
    wheel = Wheel(width=0.1, radius=0.15)
    turned = spin * DT * np.arange(T)
    run.pose[:, 1] = 0.25 + wheel.radius
    run.pose[:, 3], run.pose[:, 6] = np.cos(turned / 2), np.sin(turned / 2)
    run.machine.target[:] = run.pose
    return run._replace(tool=wheel)


def test_a_wheel_that_spins_on_the_spring_ground_pulls_by_its_friction():
    pytest.importorskip('mujoco')
    found, _ = machines.simulate(rolling(100.0, 1.0), 'spring', None)
    np.testing.assert_allclose(found[-1, 2:], [-100.0 * machines.FRICTION, 100.0], rtol=1e-3)


def test_a_wheel_on_the_formula_rests_where_its_load_is_in_balance():
    pytest.importorskip('mujoco')
    run = rolling(50.0, 0.0)
    found, _ = machines.simulate(run, 'formula', None)
    wheel = terramechanics.Wheel(
        0.15, 0.1, 50.0, 9.81, run.soil.friction, terramechanics.RIM_FRICTION
    )
    zero = np.zeros(1)
    motion = terramechanics.drive(wheel, zero, zero, terramechanics.TerrainParameters())
    assert found[-1, 3] == pytest.approx(50.0, rel=1e-3)
    assert 0.4 - found[-1, 1] == pytest.approx(motion.sinkage[0], rel=0.02)


def test_figures_of_known_motions():
    run = run_of((True, True, False))
    rows = np.column_stack([run.pose[:, :2], np.tile([30.0, 40.0], (T, 1))])
    run.force[:, :2] = [60.0, 80.0]
    rows[:60, 1] += 0.01
    found = machines.figures(rows, run)
    assert found['rms_mm'] == pytest.approx(10.0 * np.sqrt(0.5))
    assert found['end_mm'] == 0.0 and found['force_relative_l2'] == pytest.approx(0.5)
    assert found['end_force_error'] == pytest.approx(-0.5)
    assert found['drift_mm_s'] == 0.0 and found['ripple_mm'] < 1e-9
    # The height leaves its last one by 10 mm until frame 60; nothing does work over a step.
    assert found['settling_s'] == pytest.approx(60 * DT) and found['true_settling_s'] == 0.0
    assert machines.work(rows) == pytest.approx(40.0 * -0.01) and found['work_error'] is None
    rows[:, 0] += 0.002 * DT * np.arange(T)  # 2 mm/s
    rows[:, 1] += 1e-4 * (-1.0) ** np.arange(T)
    assert machines.drift(rows, run) == pytest.approx(np.hypot(2.0, 0.2 / (29 * DT)), rel=1e-9)
    assert machines.ripple(rows) == pytest.approx(0.1, rel=0.02)
    run.machine.target[:, 0] += 1e-3 * np.arange(T)
    assert machines.drift(rows, run) is None  # the machine itself goes on
    assert machines.settling(rows, run) is None
    rows[-1, 1] = -5.0
    assert machines.figures(rows, run) == {}
