"""Coarse scenes: the same code at a hundredth of the cost."""

import pytest

from mpm import packing, scenes
from mpm.constitutive import make_soil
from mpm.experiments import coarse


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
