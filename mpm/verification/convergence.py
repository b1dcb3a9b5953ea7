"""Pairs of simulations that should agree: half the step, with and without short cuts."""

from functools import cache

import numpy as np
from tqdm import tqdm

from mpm import packing, run, scenes
from mpm.constitutive import make_soil
from mpm.simulation import Settings
from mpm.solver import EXCHANGE
from mpm.verification.rows import Check
from mpm.verification.surfaces import surface

HALVED_FRAMES = 80


@cache
def packed(scene_bin, modulus: float) -> np.ndarray:
    """The settled packing of a bin, made once per process."""
    return packing.settle(scene_bin, make_soil(modulus, scenes.PACKING_MU_S), 0)[0]


def drive(scene: scenes.Scene, case: int, frames: int, settings: Settings):
    """Returns force [frames, 3] (N) of a case, and the simulation after it."""
    motion = run.prepared(scene, case, settings)
    particles = packed(scene.bin, settings.youngs_modulus)
    simulation = run.make_simulation(scene, motion, particles, settings)
    bar = tqdm(range(frames), desc=f'{scene.name} {case}', unit='frame', leave=False)
    return np.array([simulation.frame()[0] for _ in bar]), simulation


def halved_step(scene: scenes.Scene, case: int, frames: int) -> list[Check]:
    """The relative change of the mean force along x when the time step is halved."""
    force, simulation = drive(scene, case, frames, Settings())
    halved = Settings(steps=2 * round(EXCHANGE / simulation.dt))
    finer, other = drive(scene, case, frames, halved)
    mean, change = force[:, 0].mean(), finer[:, 0].mean() / force[:, 0].mean() - 1.0
    apart = _rms_mm(simulation, other)
    name = f'{scene.name} {case}: halved step, change of the mean force'
    return [Check(name, change, 0.0, 0.005, f'{frames} frames, {mean:.1f} N; soil {apart:.2f} mm')]


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
