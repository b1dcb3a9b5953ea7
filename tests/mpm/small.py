"""Coarse scenes, their packings and simulations: the same code at a hundredth of the cost."""

import dataclasses
import functools
import math

import numpy as np

from mpm import columns, constitutive, packing, run, scenes, stress
from mpm.scenes import Scene, sampled
from mpm.simulation import Settings
from mpm.solver import make_block
from mpm.transfers import keep_elastic, return_elastic

SOIL = constitutive.make_soil(1.5e6, 0.76)


def coarse(scene: Scene) -> Scene:
    """The scene on cubic cells of 4 cm (wheel: 2 cm), with as many particles per cell."""
    box = scene.bin
    dx = 0.04 if scene.name == 'excavation' else 0.02
    size = (box.size[0], box.size[1], math.ceil(box.size[2] / dx) * dx)
    return dataclasses.replace(scene, bin=sampled(size, dx, dx, 1, box.height, box.bounds))


BLADE, WHEEL = coarse(scenes.EXCAVATION), coarse(scenes.WHEEL)


@functools.cache
def _settled(box):
    return packing.settle(box, 1.5e6, 0)


def packed(scene):
    """The settled particles of a scene and their statistics; made once, a copy for each."""
    particles, statistics = _settled(scene.bin)
    return particles.copy(), statistics


def simulation(scene, case, particles=None, **settings):
    """The simulation of a case (or of a `catalogue.Motion`) before its first frame."""
    chosen = Settings(**settings)
    motion = run.prepared(scene, case, chosen) if isinstance(case, int | str) else case
    rows = packed(scene)[0] if particles is None else particles
    return run.make_simulation(scene, motion, rows, chosen)


def frames(made, count):
    """Advances a simulation; force (N) and torque (N m) on its body, [count, 6]."""
    return np.array([np.concatenate(made.frame()) for _ in range(count)])


def update(row, gradient, dt, damping=0.0, steps=1):
    """Updates the stress of one particle, a row of `COLUMNS`, in place; what acts, [6]."""
    block = make_block(row[None])
    keep_elastic(block, 0)
    block.gradient[:: columns.CHUNK] = np.ravel(gradient)
    for _ in range(steps):
        stress.update_stress(block, 0, 1, dt, SOIL, damping)
    return_elastic(block, 0)
    row[:] = block.particles[0]
    return block.stress[:: columns.CHUNK].copy()


def spline(distance):
    """The quadratic B-spline of a distance in cells."""
    d = np.abs(distance)
    return np.where(d < 0.5, 0.75 - d**2, np.where(d < 1.5, 0.5 * (1.5 - d) ** 2, 0.0))


def fails_at(monkeypatch, failing):
    """Lets the run of a case fail, as one does whose soil leaves the grid."""
    whole = run.run_case

    def run_case(scene, case, *arguments):
        if case == failing:
            raise ValueError('particle 7 left the grid at 0.1 s')
        return whole(scene, case, *arguments)

    monkeypatch.setattr(run, 'run_case', run_case)
