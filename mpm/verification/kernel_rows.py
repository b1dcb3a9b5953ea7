"""Checks that need no run of a scene."""

import math
import os
from functools import partial

import numba
import numpy as np

from mpm import columns, packing
from mpm.columns import CHUNK
from mpm.constitutive import make_soil
from mpm.experiments import Experiment, blade_in_weightless_soil
from mpm.scenes import CORNER, EARTH_GRAVITY, PACKING_MU_S, SCENES, Bin, Scene
from mpm.simulation import Settings
from mpm.solver import make_block
from mpm.stress import update_stress
from mpm.transfers import keep_elastic, return_elastic
from mpm.verification import bed, incline
from mpm.verification.rows import Check

COLUMN_ASPECTS = (0.5, 1.0, 2.0, 3.0, 5.0)  # height over length
DENSE = 55.0  # particles a cell, of the flow that is compared with a closed form


def rows_of(raw_path: str) -> dict:
    """Returns name -> function that makes the checks of that name, those that cost least first;
    packings are kept in the folder of the raw runs of both scenes."""
    rows = (free_fall, shear, momentum, incline_flow, incline_halt)
    found = {row.__name__: row for row in rows}
    found |= {f'column_{aspect:g}': partial(column, aspect) for aspect in COLUMN_ASPECTS}
    for scene in SCENES.values():
        found[f'packing_{scene.name}'] = partial(packed_soil, scene, raw_path)
    return found


def free_fall() -> list[Check]:
    """A block falls: along the parabola g t2 / 2, which velocity Verlet takes exactly."""
    block = Bin((0.2, 0.1, 0.4), 0.02, 0.04, (10, 5, 20), 1, 0.6, ())
    experiment = Experiment(block, block, make_soil(1.5e6, 0.76), lift=0.4)
    # Away from the sticky walls.
    across = experiment.particles[:, [0, 2]]
    is_kept = (np.abs(across - CORNER - [0.1, 0.2]) < [0.06, 0.12]).all(axis=1)
    experiment.particles = experiment.particles[is_kept]
    start = experiment.particles[:, :3].copy()
    exact = EARTH_GRAVITY * experiment.advance(0.2) ** 2 / 2
    fall = start - experiment.particles[:, :3]
    error = abs(fall[:, 1].mean() / exact - 1.0)
    deformation = np.abs(fall - [0.0, exact, 0.0]).max() / exact
    return [
        Check('free fall: relative error', float(error), 0.0, 1e-9, 'of g t2 / 2'),
        Check('free fall: change of shape', float(deformation), 0.0, 1e-9, 'over the fall'),
    ]


@numba.njit
def _shear(block, steps, dt, rate, soil):
    keep_elastic(block, 0)
    block.gradient[CHUNK] = rate  # dvx/dy
    for _ in range(steps):
        update_stress(block, 0, 1, dt, soil, 0.0)
    return_elastic(block, 0)


def shear(numbers: tuple = (0.01, 0.3)) -> list[Check]:
    """One particle is sheared at constant volume, at some inertial numbers."""
    rows, soil, pressure = [], make_soil(1.5e6, 0.76), 1000.0
    for number in numbers:
        rate = number * math.sqrt(pressure / soil.grain_density) / soil.grain_diameter
        particle = np.zeros((1, columns.COLUMNS))
        particle[0, columns.VOLUME_RATIO] = 1.0 / (1.0 + pressure / soil.bulk_modulus)
        block = make_block(particle)
        # Steps of a tenth of a per mille of shear, to a strain of one half.
        _shear(block, 5000, 1.0e-4 / rate, rate, soil)
        s = block.particles[0, columns.S : columns.S + 6]
        tau = math.sqrt(0.5 * (s[:3] ** 2).sum() + (s[3:] ** 2).sum())
        rise = number / soil.inertial_number_0
        mu = soil.mu_s + (soil.mu_2 - soil.mu_s) * rise / (1.0 + rise)
        name = f'shear at I = {number}: tau/p over mu(I)'
        rows.append(Check(name, tau / pressure / mu, 1.0, 0.01, 'Jop et al. 2006'))
    return rows


def momentum() -> list[Check]:
    """A blade is shot through weightless soil: the momentum that is not accounted for."""
    experiment, _ = blade_in_weightless_soil()
    impulse = experiment.impulse[:3]
    given = np.linalg.norm(impulse)
    lost = float(np.linalg.norm(experiment.momentum() + impulse) / given)
    note = f'over the impulse, {given:.1f} N s'
    return [Check('contact: momentum not accounted for', lost, 0.0, 1e-10, note)]


def column(aspect: float) -> list[Check]:
    """A column of soil collapses in a smooth channel: its run-out over the published one.

    Friction as of sand with an angle of repose of 30 degrees: mu_s = sin(30 deg), the plane
    strain value. Published (Lube, Huppert, Sparks, Freundt 2005, Phys. Rev. E 72, 041301): 1.2 a
    times the length for aspect ratios a < 1.8, 1.9 a^(2/3) for a > 2.8.
    """
    length, dx = 0.2, 0.2 / 15
    reach = length * (1.0 + 2.5 * 1.2 * aspect)
    room = Bin((dx * math.ceil(reach / dx), 0.0, 4 * dx), dx, dx, (0, 0, 0), 1, length * aspect, ())
    count, size = round(1.5 * 15), (length, length * aspect, 4 * dx)
    block = Bin(size, dx, dx, (count, round(count * aspect), 6), 1, 0.0, ())
    experiment = Experiment(room, block, make_soil(1.5e6, 0.5), smooth_sides=True)
    for _ in range(50):
        experiment.advance(1.5 / 50)
    # The farthest half per cent are single grains.
    front = np.quantile(experiment.particles[:, 0], 0.995) - CORNER
    expected = 1.2 * aspect if aspect < 1.8 else 1.9 * aspect ** (2.0 / 3.0)
    speed = np.linalg.norm(experiment.particles[:, columns.V : columns.V + 3], axis=1)
    name = f'column collapse, a = {aspect:g}: run-out over published'
    note = f'channel, Lube et al. 2005; {1e3 * np.quantile(speed, 0.99):.2g} mm/s at the end'
    return [Check(name, float(front / length - 1.0) / expected, 1.0, 0.3, note)]


def packed_soil(scene: Scene, raw_path: str) -> list[Check]:
    """The settled soil carries its weight."""
    settings, folder = Settings(), os.path.join(raw_path, scene.name)
    os.makedirs(folder, exist_ok=True)
    particles, _ = packing.settled(scene.bin, settings.youngs_modulus, settings.seed, folder)
    soil = make_soil(settings.youngs_modulus, PACKING_MU_S)
    found = bed.settled_soil(scene.bin, particles, soil)
    reaction = f'{scene.name} soil: reaction of walls and floor over weight'
    stress, middle = f'{scene.name} soil: vertical stress over rho g h', 'middle of the bin'
    # Particles of the lowest cell state 9 % more than they carry (`bed.settled_soil`). The floor's
    # reaction is the weight (first row).
    at_floor = found['stress_at_floor_over_rho_g_h']
    return [
        Check(reaction, found['reaction_over_weight'], 1.0, 0.01, 'm g'),
        Check(stress, found['stress_over_rho_g_h'], 1.0, 0.02, f'{middle}, above the lowest cell'),
        Check(stress, at_floor, 1.0, 0.12, f'{middle}, in the lowest cell'),
    ]


def incline_flow() -> list[Check]:
    """Beads flow down an incline: the kernels meet the closed form where particles are dense.

    With 2 particles a cell, as the scenes have, a shear of 12 to 24 brings particles together in
    layers: the layer is less deep and too fast. Soil in front of a tool is sheared by 1 to 3 (the
    rows of moved soil say what that does), so here that is only reported.
    """
    rows = []
    for per_cell, is_judged in ((DENSE, True), (2.0, False)):
        found = incline.bagnold(per_cell, 2.0, 4.0)
        name = f'incline, beads at {incline.FLOWING_DEG:g} degrees, {per_cell:g} particles a cell'
        for key, what, exact, note in (
            ('profile', 'profile, RMS over surface speed', 0.0, '2 to 4 s, GDR MiDi 2004'),
            ('surface', 'surface speed over closed form', 1.0, '2 to 4 s'),
            ('depth', 'depth over that before', 1.0, '2 to 4 s'),
        ):
            expected = exact if is_judged else None
            rows.append(Check(f'{name}: {what}', found[key], expected, 0.05, note))
    return rows


def incline_halt() -> list[Check]:
    """Below the static angle (20.9 and 37.2 degrees) a layer comes to rest.

    The blade's soil, whose friction hardly grows with the rate, is ill-posed (C > 0): motion
    gathers in layers of a cell, and a layer once set in motion creeps on, near the static angle
    for good. So it is judged well below that angle, by a fifth of the speed at which it begins.
    """
    rows = []
    for name, soil, degrees, limit in (
        ('beads', incline.beads(), 19.0, 1.0),
        ("the blade's soil", incline.soil_of_blade(), 30.0, 20.0),
        ("the blade's soil", incline.soil_of_blade(), 36.0, None),
    ):
        speed = 1e3 * incline.halt(soil, degrees, 2.0)
        title = f'incline, {name} at {degrees:g} degrees: mean speed after 3 s, mm/s'
        note = f'100 mm/s at first; C = {incline.posedness(soil, 0.01):.2f} at I = 0.01'
        rows.append(Check(title, speed, None if limit is None else 0.0, limit or 0.0, note))
    return rows
