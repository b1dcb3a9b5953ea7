"""Whole simulations on the coarse scenes: tools on paths, and eq. (7) of those that are free."""

import math

import numpy as np
import pytest

from mpm import bodies, columns, run, scenes
from mpm.motions import catalogue
from mpm.motions.drive import Drive, Machine, poses
from mpm.motions.grid import WHEEL_START_X
from mpm.simulation import Settings
from tests.mpm import small

HIGH = 0.6  # m, far above the soil


def carried(machine, height=HIGH):
    """The motion of a blade on a machine whose target stands still."""
    middle = small.BLADE.bin.z_middle
    drive = Drive(bodies.make_blade(0.3), lambda t: poses(t, 0.5, height, 0.0, middle), machine)
    return catalogue.Motion('test', drive, {}, 60, scenes.Ground())


def constant(*force):
    return lambda times: np.tile(force, (len(times), 1)).astype(float)


def test_a_free_mass_falls():
    machine = Machine((False, True, False), 3.0, constant(0.0, -3.0 * 9.81, 0.0))
    simulation = small.simulation(small.BLADE, carried(machine))
    assert not small.frames(simulation, 6).any()
    assert simulation.pose[1] == pytest.approx(HIGH - 9.81 * 0.1**2 / 2, abs=1e-12)


def test_an_actuator_is_a_damped_oscillator():
    """A step of a constant force on a spring with damper, x(t) in closed form."""
    mass, k, c, push = 5.0, 2.0e3, 40.0, 30.0
    is_free = True, False, False
    machine = Machine(is_free, mass, constant(push, 0.0, 0.0), 0.0, (k, 0, 0), (c, 0, 0))
    simulation = small.simulation(small.BLADE, carried(machine))
    decay, natural = c / (2 * mass), math.sqrt(k / mass)
    damped = math.sqrt(natural**2 - decay**2)
    for frame in range(1, 13):
        simulation.frame()
        t = frame / 60
        wave = math.cos(damped * t) + decay / damped * math.sin(damped * t)
        expected = 0.5 + push / k * (1.0 - math.exp(-decay * t) * wave)
        assert simulation.pose[0] == pytest.approx(expected, abs=2e-4)
    stiff = Machine(is_free, 1e-3, constant(0, 0, 0), 0.0, (1e6, 0, 0))
    with pytest.raises(ValueError, match='actuator'):
        small.simulation(small.BLADE, carried(stiff))


@pytest.mark.parametrize(
    ('push', 'words'),
    [
        (1e5, 'a free body moved by .* m where .* its load throws it, 0.000 s after the start'),
        (40.0, r'the body left the bin at 0\.\d+ s .*: its load throws it out'),
    ],
)
def test_a_load_that_throws_the_body_out_is_an_error(monkeypatch, push, words):
    """By more than the soil that it may touch is looked for, or slowly out of the bin."""
    motion = carried(Machine((False, True, False), 1.0, constant(0.0, push, 0.0)))
    monkeypatch.setattr(run, 'motion_of', lambda *_: motion)
    with pytest.raises(ValueError, match=words):
        run.run_case(small.BLADE, 'test', small.packed(small.BLADE), Settings())


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('friction_angle_deg', 14.9), ('friction_angle_deg', 50.1), ('bulk_density', 400.0),
        ('gravity', 0.0), ('tool_friction', -0.1), ('gravity', math.nan), ('youngs_modulus', -1.0),
        ('youngs_modulus', math.inf),
    ],
)  # fmt: skip
def test_a_soil_outside_the_law_is_refused(name, value):
    with pytest.raises(ValueError, match=rf'{name} is {value}, must lie in \['):
        Settings(**{name: value})


def test_wheel_is_carried_by_the_soil():
    """Mean vertical force = load, the wheel near rest in the soil, pulled forward."""
    simulation = small.simulation(small.WHEEL, 203)
    force = small.frames(simulation, 60)
    # Measured 1.2 % on cells of 17 mm.
    assert force[:, 1].mean() == pytest.approx(164.0, rel=0.03)
    height, box = simulation.free.state[0, 1], small.WHEEL.bin
    assert abs(simulation.free.state[1, 1]) < 0.02
    assert 0.0 < box.surface - (height - 0.075) < box.size[1]
    x, y, _, z = simulation.pose
    assert (x, y, z) == pytest.approx((WHEEL_START_X - 0.012, height, box.z_middle), abs=1e-9)


@pytest.mark.parametrize('case', [186, 'lift_0003'])
def test_blade_pushes_soil_and_no_soil_gets_into_it(case):
    simulation, forces = small.simulation(small.BLADE, case), []
    before = simulation.positions()
    for _ in range(60):
        forces.append(simulation.frame()[0])
        found = simulation.penetration()
        # Pressed in by some of the half spacing that contact has, 0.4 cells: measured 0 and 0.104.
        assert found['inside'] == 0 and found['deepest_cells'] < 0.15
    moved = simulation.positions() - before
    # Far from the blade nothing has moved.
    assert np.abs(moved[before[:, 0] < scenes.CORNER + 0.2]).max() < 2e-3
    if case == 186:
        draft = np.array(forces)[20:, 0]
        # Measured 742 N: on cells of 40 mm soil resists three times as much as on the scene's.
        assert draft.min() > 10.0 and draft.mean() < 1200.0 and moved[:, 0].min() < -0.02


def test_no_side_is_preferred():
    """A bed seen in a mirror gives the load seen in the mirror: z, yz and zx change their sign."""
    rows = small.packed(small.BLADE)[0]
    rows[:, 2] = 2.0 * small.BLADE.bin.z_middle - rows[:, 2]
    rows[:, columns.S + 4 : columns.S + 6] *= -1.0
    here, mirrored = (
        small.frames(small.simulation(small.BLADE, 186, particles, single=False), 30)
        for particles in (None, rows)
    )
    assert np.abs(here[:, 2]).max() > 1.0  # the grains lie as they lie
    np.testing.assert_allclose(mirrored, here * [1, 1, -1, -1, -1, 1], atol=1e-8)


def test_penetration_is_that_of_the_deepest_particle():
    """A particle put on the middle line of the blade."""
    simulation = small.simulation(small.BLADE, 186)
    x, y, angle, z = simulation.pose
    simulation.particles[5, :3] = [x - 0.1 * np.sin(angle), y + 0.1 * np.cos(angle), z]
    found = simulation.penetration()
    assert found == {'deepest_cells': pytest.approx(0.014 / simulation.grid.dx), 'inside': 1}
