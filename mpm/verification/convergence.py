"""Pairs of simulations that should agree: half the step, finer cells, short cuts, other law."""

import dataclasses
from functools import cache

import numpy as np
from tqdm import tqdm

from mpm import packing, scenes
from mpm.constitutive import make_soil
from mpm.run import make_simulation, soil_of
from mpm.simulation import Settings
from mpm.verification.rows import Check, reported
from mpm.verification.surfaces import surface

FINER = 0.75  # cells of `finer_cells` over those of the scene
HALVED_FRAMES = 80


@cache
def packed(scene_bin, modulus: float) -> np.ndarray:
    """The settled packing of a bin, made once per process."""
    return packing.settle(scene_bin, make_soil(modulus, scenes.PACKING_MU_S), 0)[0]


def drive(scene: scenes.Scene, case: int, frames: int, settings: Settings):
    """Returns force [frames, 3] (N) of a case, and the simulation after it."""
    parameters = scene.parameters(case)
    soil = soil_of(scene, parameters, settings)
    particles = packed(scene.bin, settings.youngs_modulus)
    simulation = make_simulation(scene, parameters, soil, particles, settings)
    bar = tqdm(range(frames), desc=f'{scene.name} {case}', unit='frame', leave=False)
    return np.array([simulation.frame()[0] for _ in bar]), simulation


def halved_step(scene: scenes.Scene, case: int, frames: int, dilation: float = 0.0) -> list[Check]:
    """The relative change of the mean force along x when the time step is halved."""
    force, simulation = drive(scene, case, frames, Settings(dilation=dilation))
    halved = Settings(steps_per_frame=2 * simulation.steps, dilation=dilation)
    finer, other = drive(scene, case, frames, halved)
    mean, change = force[:, 0].mean(), finer[:, 0].mean() / force[:, 0].mean() - 1.0
    apart = _rms_mm(simulation, other)
    what = f'{scene.name} {case}' + (', dilating soil' if dilation else '')
    name = f'{what}: halved step, change of the mean force'
    return [Check(name, change, 0.0, 0.01, f'{frames} frames, {mean:.1f} N; soil {apart:.2f} mm')]


SHORT_CUTS = {'sleep': 'sleeping soil', 'single': 'steps in float32'}  # options of `Settings`


def short_cut(option: str, scene: scenes.Scene, case: int, frames: int) -> list[Check]:
    """What a short cut changes, against the run without it: mean force along x, and the soil."""
    force, simulation = drive(scene, case, frames, Settings())
    without, other = drive(scene, case, frames, Settings(**{option: False}))
    change = force[:, 0].mean() / without[:, 0].mean() - 1.0
    name = f'{scene.name} {case}: {SHORT_CUTS[option]}'
    note = f'{frames} frames, {without[:, 0].mean():.1f} N'
    apart = surface(simulation.positions(), scene.bin) - surface(other.positions(), scene.bin)
    rms = 1e3 * float(np.sqrt((apart**2).mean()))
    return [
        Check(f'{name}, change of the mean force', change, 0.0, 0.01, note),
        Check(
            f'{name}, surface in mm RMS', rms, 0.0, 0.5,
            f'at the end; all soil {_rms_mm(simulation, other):.2f} mm',
        ),
    ]  # fmt: skip


def _rms_mm(one, other) -> float:
    apart = one.positions() - other.positions()
    return float(1e3 * np.sqrt((apart**2).sum(axis=1).mean()))


def finer_cells(scene: scenes.Scene, case: int, frames: int) -> list[Check]:
    """Draft and surface on cells 0.75 times as long with as many particles in each."""
    box = scene.bin
    lattice = tuple(round(n / FINER) for n in box.lattice)
    finer = dataclasses.replace(
        scene, bin=dataclasses.replace(box, dx=FINER * box.dx, lattice=lattice)
    )
    force, simulation = drive(scene, case, frames, Settings())
    fine, other = drive(finer, case, frames, Settings())
    ratio = fine[:, 0].mean() / force[:, 0].mean()
    apart = surface(other.positions(), finer.bin) - surface(simulation.positions(), box)
    name = f'{scene.name} {case}: cells x {FINER}'
    note = f'{frames} frames, {force[:, 0].mean():.1f} N before'
    return [
        reported(f'{name}, mean force over that before', ratio, note),
        reported(f'{name}, surface in mm RMS', 1e3 * float(np.sqrt((apart**2).mean())), 'squares'),
    ]


def nonlocal_law(scene: scenes.Scene, case: int, frames: int) -> list[Check]:
    """The nonlocal law at full size: it runs, nothing leaks, and how it differs."""
    force, _ = drive(scene, case, frames, Settings())
    other, simulation = drive(scene, case, frames, Settings(rheology='nonlocal'))
    ratio = other[:, 0].mean() / force[:, 0].mean()
    name = f'{scene.name} {case}: nonlocal law'
    deepest = simulation.penetration()['deepest_cells']
    return [
        Check(f'{name}, mean force over that of mu(I)', ratio, 1.0, 0.3, f'{frames} frames'),
        Check(f'{name}, deepest particle in cells', deepest, 0.0, 0.25, 'at the end'),
    ]
