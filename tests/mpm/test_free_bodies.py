"""Eq. (7): free coordinates of a body against closed forms, and at rest on the soil."""

import math

import numpy as np
import pytest

from mpm import bodies, run, scenes
from mpm.motions import catalogue
from mpm.motions.drive import Drive, Machine
from mpm.simulation import Settings
from mpm.stability import UnstableTimeStepError

HIGH = 0.6  # m, far above the soil


def carried(scene, packed, machine, height=HIGH, rest=0):
    """A simulation of the blade on a machine whose target stands still."""

    def pose(times):
        return np.tile([0.5, height, 0.0, scene.bin.z_middle], (len(np.asarray(times)), 1))

    drive = Drive(bodies.make_blade(0.3), pose, machine, rest=rest)
    motion = catalogue.Motion('test', drive, {}, 60, scenes.Ground())
    return run.make_simulation(scene, motion, packed[0], Settings())


def constant(*force):
    return lambda times: np.tile(force, (len(times), 1)).astype(float)


def test_a_free_mass_falls(coarse_excavation, excavation_packing):
    machine = Machine((False, True, False), 3.0, constant(0.0, -3.0 * 9.81, 0.0))
    simulation = carried(coarse_excavation, excavation_packing, machine)
    for _ in range(6):
        force, _ = simulation.frame()
    assert not force.any()
    assert simulation.pose[1] == pytest.approx(HIGH - 9.81 * 0.1**2 / 2, abs=1e-12)


def test_an_actuator_is_a_damped_oscillator(coarse_excavation, excavation_packing):
    """A step of a constant force on a spring with damper, x(t) in closed form."""
    mass, k, c, push = 5.0, 2.0e3, 40.0, 30.0
    machine = Machine(
        (True, False, False), mass, constant(push, 0.0, 0.0), 0.0, (k, 0, 0), (c, 0, 0)
    )
    simulation = carried(coarse_excavation, excavation_packing, machine)
    decay, natural = c / (2 * mass), math.sqrt(k / mass)
    damped = math.sqrt(natural**2 - decay**2)
    for frame in range(1, 13):
        simulation.frame()
        t = frame / 60
        wave = math.cos(damped * t) + decay / damped * math.sin(damped * t)
        expected = 0.5 + push / k * (1.0 - math.exp(-decay * t) * wave)
        assert simulation.pose[0] == pytest.approx(expected, abs=2e-4)


def test_a_stiff_actuator_is_refused(coarse_excavation, excavation_packing):
    machine = Machine((True, False, False), 1e-3, constant(0, 0, 0), 0.0, (1e6, 0, 0))
    with pytest.raises(UnstableTimeStepError, match='actuator'):
        carried(coarse_excavation, excavation_packing, machine)


@pytest.mark.parametrize(
    ('push', 'words'),
    [
        (1e5, 'a free body moved by .* m where .* its load throws it, 0.000 s after the start'),
        (40.0, r'the body left the bin at 0\.\d+ s .*: its load throws it out'),
    ],
)
def test_a_load_that_throws_the_body_out_is_an_error(
    coarse_excavation, excavation_packing, monkeypatch, push, words
):
    """By more than the soil that it may touch is looked for, or slowly out of the bin."""
    machine = Machine((False, True, False), 1.0, constant(0.0, push, 0.0))
    drive = carried(coarse_excavation, excavation_packing, machine).drive
    motion = catalogue.Motion('test', drive, {}, 60, scenes.Ground())
    monkeypatch.setattr(run, 'motion_of', lambda *_: motion)
    with pytest.raises(ValueError, match=words):
        run.run_case(coarse_excavation, 'test', excavation_packing, Settings())


def test_soil_carries_a_tool_at_rest(coarse_excavation, excavation_packing):
    weight = 20.0 * 9.81

    def force(times):
        return np.outer(np.clip(times / 0.4, 0.0, 1.0), [0.0, -weight, 0.0])

    machine = Machine((False, True, False), 20.0, force)
    start = coarse_excavation.bin.surface + 0.02
    simulation = carried(coarse_excavation, excavation_packing, machine, start)
    loads = np.array([simulation.frame()[0] for _ in range(150)])
    assert loads[-30:, 1].mean() == pytest.approx(weight, rel=0.02)
    assert abs(simulation.free.state[1, 1]) < 5e-3  # m/s


def test_a_run_says_what_drove_it(coarse_excavation, excavation_packing, monkeypatch):
    monkeypatch.setattr(scenes, 'FRAMES', 9)
    made = run.run_case(coarse_excavation, 'free_0000', excavation_packing, Settings())
    assert made.target.shape == made.external.shape == (9, 3)
    assert made.subframe_force.shape == (9, 4, 3)
    np.testing.assert_allclose(made.subframe_force.mean(axis=1), made.force, atol=1e-3)
    machine = made.parameters['machine']
    assert machine['is_free'][1] and machine['mass_kg'] > 0.0


def test_soil_of_the_settings_arrives_in_the_record(
    coarse_excavation, excavation_packing, monkeypatch
):
    monkeypatch.setattr(scenes, 'FRAMES', 3)
    settings = Settings(
        friction_angle_deg=33.0, bulk_density=1500.0, gravity=3.72, tool_friction=0.1
    )
    made = run.run_case(coarse_excavation, 22, excavation_packing, settings).parameters
    assert made['friction_angle_deg'] == made['set_friction_angle_deg'] == 33.0
    assert made['gravity_m_s2'] == made['set_gravity_m_s2'] == 3.72
    assert made['soil']['bulk_density'] == made['bulk_density_kg_m3'] == 1500.0
    assert made['soil']['mu_s'] == pytest.approx(math.tan(math.radians(33.0)))
    assert made['body_friction'] == made['set_tool_friction'] == 0.1
    usual = run.run_case(coarse_excavation, 22, excavation_packing, Settings()).parameters
    assert not [name for name in usual if name.startswith('set_')]


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('friction_angle_deg', 14.9), ('friction_angle_deg', 50.1), ('bulk_density', 400.0),
        ('gravity', 0.0), ('tool_friction', -0.1), ('gravity', math.nan),
    ],
)  # fmt: skip
def test_a_soil_outside_the_law_is_refused(name, value):
    with pytest.raises(ValueError, match=rf'{name} is {value}, must lie in \['):
        Settings(**{name: value})
