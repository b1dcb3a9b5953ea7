"""The two scenes of the thesis: their bins and their tables of cases.

Axes: x along the drive (towards -x), y up, z across. The soil's bin begins at 0.1 m on each axis,
so that every coordinate is positive. Case numbers are those of the published data:
1 + nested loops over the parameters, the last one fastest.

Sources: Usmani (2023), thesis, section 2.3; Haeri and Skonieczny (2021), Subspace Graph Physics.
"""

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from mpm import bodies
from mpm.constitutive import friction_coefficient

FRAME_RATE = 60.0
FRAMES = 321  # the state before driving, then 320 driven frames
CORNER = 0.1  # m, lower corner of the bin on each axis
EARTH_GRAVITY = 9.81


@dataclass(frozen=True)
class Bin:
    """The soil's box and how it is sampled.

    Attributes:
        size: length, depth of soil, width in m.
        dx: cell size of the grid, m. Length and width are whole numbers of cells.
        lattice: soil particles per axis of the initial packing.
        keep_every: every how many particles are written.
        height: height of the grid above the floor, m.
        bounds: [low, high] per axis in m; everything stays inside.
        wall_gap: how far each wall across stands outside the soil, m; see `coarse`.
        simulate_every: every how many particles of the lattice are simulated; see `coarse`.
    """

    size: tuple
    dx: float
    lattice: tuple
    keep_every: int
    height: float
    bounds: tuple
    wall_gap: float = 0.0
    simulate_every: int = 1

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
    """One scene: the bin, the table of cases, what moves.

    Attributes:
        name: 'excavation' or 'wheel'.
        rigid_motion: 'prescribed', or 'driven' (rotation and travel given, height free).
        levels: parameter name -> its values, outermost loop first.
        context_names: parameters that the dataset gives to the network.
        published: cases whose records were published.
        demo_case: reserved for the demonstration; never in the mini set.
        bin: the soil.
    """

    name: str
    rigid_motion: str
    levels: dict
    context_names: tuple
    published: tuple
    demo_case: int
    bin: Bin = field(repr=False, default=None)

    @property
    def case_count(self) -> int:
        """Number of cases in the whole grid."""
        return math.prod(len(values) for values in self.levels.values())

    def parameters(self, case: int) -> dict:
        """Returns the parameters of a case, by name.

        Raises:
            ValueError: if there is no such case.
        """
        if not 1 <= case <= self.case_count:
            raise ValueError(f'{self.name} has cases 1 to {self.case_count}, got {case}')
        index = np.unravel_index(case - 1, [len(v) for v in self.levels.values()])
        return {name: values[i] for (name, values), i in zip(self.levels.items(), index)}

    def case_id(self, **parameters) -> int:
        """Returns the case number of a combination of parameters (the inverse of `parameters`)."""
        case = 0
        for name, values in self.levels.items():
            case = case * len(values) + values.index(parameters[name])
        return case + 1


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
    published=(186, 146, 123, 213, 22, 99, 78, 118, 216, 231, 188),
    demo_case=125,
    bin=Bin(
        size=(0.8, 0.15, 0.6),
        dx=0.8 / 60,
        lattice=(56, 11, 42),
        keep_every=5,
        height=0.5,
        bounds=((0.0, 1.2), (0.0, 0.8), (0.0, 0.8)),
    ),
)

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
    published=(44, 154, 137, 103, 23, 112, 58, 56, 134, 9, 107, 203),
    demo_case=122,
    bin=Bin(
        # 23 cells wide: the walls lie on nodes.
        size=(0.4, 0.058, 23 * 0.4 / 48),
        dx=0.4 / 48,
        lattice=(64, 9, 30),
        keep_every=3,
        height=0.2,
        bounds=((0.0, 0.7), (0.0, 0.6), (0.0, 0.4)),
    ),
)

SCENES = {scene.name: scene for scene in (EXCAVATION, WHEEL)}

EXCAVATION_MU_S = 0.76
PACKING_MU_S = 0.76  # one packing for all friction angles
SMALL_WHEEL_LOAD_DIVISOR = 9.0


def scene_named(name: str) -> Scene:
    """Returns the scene of that name.

    Raises:
        ValueError: if there is none.
    """
    if name not in SCENES:
        raise ValueError(f'unknown scene {name!r}; there are {sorted(SCENES)}')
    return SCENES[name]


def wheel_load(parameters: dict) -> float:
    """Returns the load on the wheel in N; the smallest wheel carries a ninth."""
    if parameters['diameter_m'] < 0.1:
        return parameters['load_N'] / SMALL_WHEEL_LOAD_DIVISOR
    return parameters['load_N']


def gravity_of(scene: Scene, parameters: dict) -> float:
    """Returns the gravity of a case in m/s2."""
    return parameters['gravity_m_s2'] if scene.name == 'wheel' else EARTH_GRAVITY


def static_friction(scene: Scene, parameters: dict) -> float:
    """Returns mu_s of a case: tan(phi) for the wheel, the published constant for the blade."""
    if scene.name == 'wheel':
        return friction_coefficient(parameters['friction_angle_deg'])
    return EXCAVATION_MU_S


def context_of(scene: Scene, parameters: dict) -> dict:
    """Returns the values of `scene.context_names` for a case."""
    if not scene.context_names:
        return {}
    return {
        'gravity': parameters['gravity_m_s2'],
        'friction_angle_deg': parameters['friction_angle_deg'],
        'load': wheel_load(parameters),
    }


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


def mini_cases(scene: Scene, count: int = 40) -> tuple:
    """Returns `count` cases spread over the grid, the published ones among them, sorted.

    After the published ones, each next case is the one whose levels were used least so far; of
    equal ones, that farthest from all chosen; then the lowest number. No randomness.
    """
    sizes = [len(values) for values in scene.levels.values()]
    grid = np.array(list(itertools.product(*map(range, sizes))))
    place = grid / (np.array(sizes) - 1)
    used = [np.zeros(size, dtype=int) for size in sizes]
    distance = np.full(len(grid), np.inf)
    chosen = []

    def choose(index):
        nonlocal distance
        chosen.append(index)
        for axis, level in enumerate(grid[index]):
            used[axis][level] += 1
        distance = np.minimum(distance, np.linalg.norm(place - place[index], axis=1))

    for case in scene.published:
        choose(case - 1)
    while len(chosen) < count:
        crowd = sum(used[a][grid[:, a]] * sizes[a] for a in range(len(sizes))).astype(float)
        crowd[chosen] = np.inf
        crowd[scene.demo_case - 1] = np.inf
        best = np.flatnonzero(crowd == crowd.min())
        choose(best[np.argmax(distance[best])])
    return tuple(sorted(int(i) + 1 for i in chosen))


def select_cases(scene: Scene, text: str) -> tuple:
    """Returns the cases that `text` names: 'mini', 'full' or numbers separated by commas.

    Raises:
        ValueError: if it names none, or one twice, or one that does not exist.
    """
    if text == 'mini':
        return mini_cases(scene)
    if text == 'full':
        return tuple(range(1, scene.case_count + 1))
    try:
        cases = [int(part) for part in text.split(',')]
    except ValueError as error:
        raise ValueError(
            f"cases must be 'mini', 'full' or numbers separated by commas, got {text!r}"
        ) from error
    for case in cases:
        scene.parameters(case)
    if len(set(cases)) != len(cases):
        raise ValueError(f'a case is named twice in {text!r}')
    return tuple(cases)
