"""Bekker, Wong and Janosi against the integrals over the contact arc and against a known case."""

import dataclasses

import numpy as np
import pytest
from scipy import integrate

from learning_to_simulate.baselines.wheel_terramechanics import TerrainParameters, Wheel, drive

RADIUS, WIDTH = 0.15, 0.12
FIRM = TerrainParameters(k_c=0.0, k_phi=2e6, n=1.0, elastic=1e4)


def wheel(load=100.0, soil_friction=0.6, rim_friction=10.0, gravity=9.81):
    return Wheel(RADIUS, WIDTH, load, gravity, soil_friction, rim_friction)


def straight(slip, length=0.3, n_frame=600):
    """Travel and rolled path [T] at a constant slip 1 - v / (omega R)."""
    travel = np.linspace(0.0, length, n_frame)
    return travel, travel / (1.0 - slip)


def test_at_rest_the_soil_bears_by_its_pressure_over_both_halves_of_the_arc():
    """No shear: W = b int k (z - rim) dx over the chord."""
    motion = drive(wheel(), *straight(0.0, n_frame=1), FIRM, n_bin=2000)
    z = motion.sinkage[0]
    end = np.sqrt(RADIUS**2 - (RADIUS - z) ** 2)
    load, _ = integrate.quad(
        lambda x: FIRM.k_phi * (z - RADIUS + np.sqrt(RADIUS**2 - x**2)), -end, end
    )
    assert WIDTH * load == pytest.approx(100.0, rel=1e-3)
    assert motion.drawbar[0] == pytest.approx(0.0, abs=1e-6)
    assert motion.torque[0] == 0.0


@pytest.mark.parametrize('slip', [0.1, 0.4])
def test_steady_driving_is_wong_and_reeces_integral(slip):
    """sigma = k (R cos a - R cos a1)^n; j of a point of the soil: the rim passes it at
    omega R - v cos a, while R cos a da = -v dt."""
    # Stiff unloading: no contact behind the lowest point but in one bin.
    parameters = dataclasses.replace(FIRM, n=1.1, shear_modulus=0.01, elastic=1e7)
    motion = drive(wheel(), *straight(slip, 0.1, 400), parameters, n_bin=300)
    z = motion.sinkage[-1]
    entry = np.arccos(1 - z / RADIUS)

    def stresses(a):
        sigma = parameters.k_phi * (RADIUS * (np.cos(a) - np.cos(entry))) ** parameters.n
        j = RADIUS * (
            (np.sin(entry) - np.sin(a)) / (1 - slip)
            - (entry - a) / 2
            - (np.sin(2 * entry) - np.sin(2 * a)) / 4
        )
        return sigma, 0.6 * sigma * (1 - np.exp(-j / parameters.shear_modulus))

    def integral(f):
        return RADIUS * WIDTH * integrate.quad(lambda a: f(a, *stresses(a)), 0.0, entry)[0]

    vertical = integral(lambda a, sigma, tau: sigma * np.cos(a) + tau * np.sin(a))
    drawbar = integral(lambda a, sigma, tau: tau * np.cos(a) - sigma * np.sin(a))
    torque = RADIUS * integral(lambda a, sigma, tau: tau)
    # A bin is 1 % of the contact. Wong & Reece's own j would pull 7 N less at a slip of 0.4.
    assert motion.vertical[-1] == pytest.approx(100.0, abs=0.1)
    assert vertical == pytest.approx(100.0, abs=2.0)
    assert motion.drawbar[-1] == pytest.approx(drawbar, abs=1.5)
    assert motion.torque[-1] / RADIUS == pytest.approx(torque / RADIUS, abs=1.5)


def test_a_rim_that_slides_pulls_less():
    rough, smooth = (
        drive(wheel(rim_friction=friction), *straight(0.4, n_frame=100), FIRM).drawbar[-1]
        for friction in (10.0, 0.2)
    )
    assert smooth < 0.5 * rough


def test_soil_bears_in_proportion_to_gravity():
    deep = drive(wheel(gravity=1.62), *straight(0.0, n_frame=1), FIRM).sinkage[0]
    light = drive(wheel(load=100.0 * 9.81 / 1.62), *straight(0.0, n_frame=1), FIRM).sinkage[0]
    assert deep == pytest.approx(light, rel=1e-6)


def test_a_wheel_that_rolls_back_runs_in_its_own_rut():
    """Soil that was pressed in stays so, and bears at once: the second pass sinks a little more."""
    there = np.linspace(0.0, 0.2, 80)
    travel = np.concatenate([there, there[-2::-1]])
    sunk = drive(wheel(), travel, travel, dataclasses.replace(FIRM, elastic=20.0)).sinkage
    first, second = sunk[40], sunk[118]  # the same place
    assert first < second < 1.5 * first


def test_a_soil_too_soft_buries_the_wheel_to_its_axle():
    soft = dataclasses.replace(FIRM, k_phi=1e2)
    motion = drive(wheel(), *straight(0.0, n_frame=3), soft)
    assert motion.sinkage == pytest.approx(RADIUS)
    assert (motion.vertical < 100.0).all()
