"""Coarse scenes: the same code at a hundredth of the cost."""

import dataclasses

import pytest

from mpm import packing, scenes
from mpm.constitutive import make_soil


def coarse(scene: scenes.Scene) -> scenes.Scene:
    """Returns the scene on cells twice as long, with as many particles per cell."""
    box = scene.bin
    cells = [round(box.size[0] / box.dx) // 2, round(box.size[2] / box.dx) // 2]
    dx = box.size[0] / cells[0]
    size = (box.size[0], box.size[1], cells[1] * dx)
    lattice = tuple(max(2, n // 2) for n in box.lattice)
    return dataclasses.replace(
        scene, bin=dataclasses.replace(box, dx=dx, size=size, lattice=lattice)
    )


@pytest.fixture(scope='session')
def soil():
    return make_soil(1.5e6, 0.76)


@pytest.fixture(scope='session')
def coarse_excavation():
    return coarse(scenes.EXCAVATION)


@pytest.fixture(scope='session')
def coarse_wheel():
    return coarse(scenes.WHEEL)


@pytest.fixture(scope='session')
def excavation_packing(coarse_excavation, soil):
    return packing.settle(coarse_excavation.bin, soil, 0)


@pytest.fixture(scope='session')
def wheel_packing(coarse_wheel, soil):
    return packing.settle(coarse_wheel.bin, soil, 0)
