"""The two scenes of the thesis: their bins and their tables of cases.

Axes: x along the drive (towards -x), y up, z across. The soil's bin begins at 0.1 m on each axis,
so that every coordinate is positive. Case numbers are those of the published data:
1 + nested loops over the parameters, the last one fastest.

Sources: Usmani (2023), thesis, section 2.3; Haeri and Skonieczny (2021), Subspace Graph Physics.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mpm import bodies
from mpm.constitutive import PACKED_DENSITY

FRAME_RATE = 60.0
FRAMES = 321  # the state before driving, then 320 driven frames
DURATION = (FRAMES - 1) / FRAME_RATE  # s
CORNER = 0.1  # m, lower corner of the bin on each axis
EARTH_GRAVITY = 9.81


@dataclass(frozen=True)
class Bin:
    """The soil's box and how it is sampled."""

    size: tuple  # length, depth of soil, width in m
    dx: float  # length of a cell in the plane of travel, m; the length is a whole number of them
    dz: float  # length of a cell across, m; the width is a whole number of them
    lattice: tuple  # soil particles per axis of the initial packing
    keep_every: int  # every how many particles are written
    height: float  # height of the grid above the floor, m
    bounds: tuple  # [low, high] per axis in m; everything stays inside

    @property
    def surface(self) -> float:
        """Height of the flat soil surface, m."""
        return CORNER + self.size[1]

    @property
    def z_middle(self) -> float:
        """z of the middle of the bin, m."""
        return CORNER + self.size[2] / 2


@dataclass(frozen=True)
class Scene:
    """One scene: the bin, the table of cases, what moves."""

    name: str  # 'excavation' or 'wheel'
    rigid_motion: str  # 'prescribed', or 'driven' (rotation and travel given, height free)
    levels: dict  # parameter name -> its values, outermost loop first
    context_names: tuple  # parameters that the dataset gives to the network
    # 40 cases spread over the grid, each level equally often (to one); the published ones are
    # among them, `demo_case` is not
    mini: tuple
    demo_case: int  # of usual values
    bin: Bin = field(repr=False, default=None)  # the soil
    # Name -> bin of kinds of runs that do not fit into that one
    other_bins: dict = field(repr=False, default_factory=dict)

    @property
    def case_count(self) -> int:
        return math.prod(len(values) for values in self.levels.values())

    def parameters(self, case: int) -> dict:
        """Returns the parameters of a case, by name; ValueError if there is no such case."""
        if not 1 <= case <= self.case_count:
            raise ValueError(f'{self.name} has cases 1 to {self.case_count}, got {case}')
        index = np.unravel_index(case - 1, [len(v) for v in self.levels.values()])
        return {name: values[i] for (name, values), i in zip(self.levels.items(), index)}


WHEEL_BIN_WIDTH = 23 * 0.4 / 48  # m; the published 0.19 in whole cells of 0.4 / 48 m
PER_CELL = 2.0  # particles; fewer integrate the stress too coarsely and pack moved soil


def sampled(
    size: tuple, dx: float, dz: float, keep_every: int, height: float, bounds: tuple,
    per_cell: float = PER_CELL,
) -> Bin:  # fmt: skip
    """Returns a bin whose cells hold `per_cell` particles each, their spacing along an axis in
    proportion to the cell's side."""
    share = per_cell ** (-1.0 / 3.0)
    lattice = tuple(round(side / (share * cell)) for side, cell in zip(size, (dx, dx, dz)))
    return Bin(size, dx, dz, lattice, keep_every, height, bounds)


def _blade_bin(length: float, width: float, keep_every: int = 31) -> Bin:
    # `keep_every` has no factor in common with the sides of the lattices: what is written lies in
    # all planes.
    high = ((0.0, length + 0.4), (0.0, 0.8), (0.0, width + 0.2))
    return sampled((length, 0.15, width), 0.8 / 120, 0.02, keep_every, 0.5, high)


EXCAVATION = Scene(
    name='excavation',
    rigid_motion='prescribed',
    levels={
        'depth_m': (0.02, 0.04, 0.05, 0.08, 0.10),
        'speed_m_s': (0.01, 0.04, 0.08, 0.10, 0.15),
        'angle_deg': (0.0, 3.8, 10.0, 30.8, 45.0),
        'motion': (1, 2),
    },
    context_names=(),
    # Published: 22, 78, 99, 118, 123, 146, 186, 188, 213, 216, 231.
    mini=(
        1, 6, 9, 10, 21, 22, 44, 50, 63, 64, 77, 78, 84, 85, 93, 99, 102, 117, 118, 123, 124, 132,
        139, 146, 155, 159, 166, 177, 186, 188, 195, 197, 210, 212, 213, 216, 227, 231, 239, 242,
    ),
    demo_case=125,
    bin=_blade_bin(0.8, 0.6),
    # Neighbouring cuts and wide tools; a long cut, whose heap must not reach the walls beside it.
    other_bins={'wide': _blade_bin(0.8, 1.2), 'long': _blade_bin(2.0, 1.0, 5 * 31)},
)  # fmt: skip

WHEEL = Scene(
    name='wheel',
    rigid_motion='driven',
    levels={
        'gravity_m_s2': (1.62, 3.72, 9.81),
        'slip_percent': (20, 40, 70),
        'load_N': (100.0, 164.0, 225.0),
        'diameter_m': (0.05, 0.15, 0.30),
        'friction_angle_deg': (30.0, 37.0, 43.0),
    },
    context_names=('gravity', 'friction_angle_deg', 'load'),
    # Published: 9, 23, 44, 56, 58, 103, 107, 112, 134, 137, 154, 203.
    mini=(
        1, 3, 5, 7, 9, 13, 23, 37, 44, 56, 58, 63, 78, 79, 83, 91, 103, 107, 112, 119, 123, 129,
        134, 137, 149, 154, 159, 163, 170, 174, 203, 204, 205, 207, 212, 216, 224, 228, 240, 241,
    ),
    demo_case=122,
    bin=sampled(
        (0.4, 0.058, WHEEL_BIN_WIDTH), 0.4 / 96, WHEEL_BIN_WIDTH / 15, 7, 0.2,
        ((0.0, 0.7), (0.0, 0.6), (0.0, 0.4)),
    ),
)  # fmt: skip

SCENES = {scene.name: scene for scene in (EXCAVATION, WHEEL)}

EXCAVATION_FRICTION_DEG = math.degrees(math.atan(0.76))  # the published mu_s
PACKING_MU_S = 0.76  # one packing for all friction angles
SMALL_WHEEL_LOAD_DIVISOR = 9.0


def wheel_load(parameters: dict) -> float:
    """Returns the load on the wheel in N; the smallest wheel carries a ninth."""
    is_small = parameters['diameter_m'] < 0.1
    return parameters['load_N'] / (SMALL_WHEEL_LOAD_DIVISOR if is_small else 1.0)


class Ground(NamedTuple):
    """What may differ between the beds of runs."""

    # phi; mu_s is tan(phi) (`constitutive.friction_coefficient`)
    friction_angle_deg: float = EXCAVATION_FRICTION_DEG
    bulk_density: float = PACKED_DENSITY  # kg/m3, as packed
    gravity: float = EARTH_GRAVITY  # m/s2
    slope_deg: float = 0.0  # by which the ground rises where tools go, towards -x: gravity leans


def ground_of(scene: Scene, parameters: dict) -> Ground:
    """Returns the ground of a case of the grid."""
    if scene.name == 'wheel':
        return Ground(parameters['friction_angle_deg'], gravity=parameters['gravity_m_s2'])
    return Ground()


def describe(scene: Scene) -> dict:
    """Returns the scene as the manifest of raw runs and `metadata.json` carry it."""
    edges = [list(edge) for edge in bodies.wheel_edges()] if scene.name == 'wheel' else []
    return {
        'name': scene.name,
        'rigid_motion': scene.rigid_motion,
        'rigid_edges': edges,
        'context_names': list(scene.context_names),
        'force': True,
        'up_axis': 1,
    }
