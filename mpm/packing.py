"""The settled soil from which every run of a scene starts.

Blade forces depend on the packing more than on anything else, so there is one per scene: a
jittered lattice (seeded), settled under gravity until it rests. It fixes number and order of the
particles of all runs. The settled stress is elastic; at another gravity it scales with it.
"""

import json
import os
from dataclasses import dataclass

import numpy as np

from mpm import columns, solver, stability
from mpm.constitutive import Soil
from mpm.files import read_arrays, write_arrays
from mpm.scenes import CORNER, EARTH_GRAVITY, Bin

PACKING_FILE = 'packing.npz'
PAD = 3  # nodes outside the bin on the low side
JITTER = 0.1  # of the lattice spacing, half width of the uniform jitter
SETTLE_TIME = 0.4  # s
SETTLE_DAMPING = 20.0  # 1/s
REST_SPEED = 0.02  # m/s, largest speed of a settled soil; the settling could fall at 3.9


@dataclass(frozen=True)
class Grid:
    """The background grid of a bin.

    Attributes:
        shape: nodes per axis.
        origin: position of node (0, 0, 0), m.
        dx: cell size, m.
        walls: node indices (x low, x high, floor, z low, z high) of the sticky walls, and 1 if
            the walls across z are smooth instead.
    """

    shape: tuple
    origin: tuple
    dx: float
    walls: tuple

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return self.shape[0] * self.shape[1] * self.shape[2]


def make_grid(box: Bin) -> Grid:
    """Returns the grid of a bin; its walls and floor lie on planes of nodes.

    Raises:
        ValueError: if length or width are not a whole number of cells.
    """
    width = box.size[2] + 2 * box.wall_gap
    cells = [box.size[0] / box.dx, box.height / box.dx, width / box.dx]
    for name, count in (('length', cells[0]), ('width', cells[2])):
        if abs(count - round(count)) > 1e-6:
            raise ValueError(f'the {name} of the bin must be whole cells, got {count:.6g}')
    nx, ny, nz = round(cells[0]), int(np.ceil(cells[1])), round(cells[2])
    return Grid(
        shape=(nx + 2 * PAD + 1, ny + 2 * PAD + 1, nz + 2 * PAD + 1),
        origin=(*(CORNER - PAD * box.dx,) * 2, CORNER - box.wall_gap - PAD * box.dx),
        dx=box.dx,
        walls=(PAD, PAD + nx, PAD, PAD, PAD + nz, 0),
    )


def particle_volume(box: Bin) -> float:
    """Returns the packed volume of soil per simulated particle, m3."""
    simulated = range(0, int(np.prod(box.lattice)), box.simulate_every)
    return float(np.prod(box.size)) / len(simulated)


def lattice(box: Bin, seed: int) -> np.ndarray:
    """Returns the unsettled particle array [N, COLUMNS]: a jittered lattice, free of stress."""
    spacing = np.array(box.size) / box.lattice
    axes = [CORNER + (np.arange(n) + 0.5) * h for n, h in zip(box.lattice, spacing)]
    positions = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 3)
    noise = np.random.default_rng(seed).uniform(-JITTER, JITTER, positions.shape)
    particles = np.zeros((len(positions), columns.COLUMNS))
    particles[:, :3] = positions + noise * spacing
    particles[:, columns.VOLUME_RATIO] = 1.0
    particles[:, columns.IDENTITY] = np.arange(len(positions))
    return particles


def settle(box: Bin, soil: Soil, seed: int) -> tuple[np.ndarray, dict]:
    """Settles the lattice under the gravity of the Earth.

    Returns:
        The particle array [N, COLUMNS] in the order of identity, at rest, and its statistics.

    Raises:
        ValueError: if the soil does not come to rest.
    """
    grid = make_grid(box)
    particles = lattice(box, seed)
    start = particles[:, :3].copy()
    steps = stability.steps_per_frame(SETTLE_TIME, soil, grid.dx)
    dt = SETTLE_TIME / steps
    work = np.zeros(4 * grid.nodes)
    status = np.zeros(3, dtype=np.int64)
    for part in range(10):
        particles = sort_by_cell(particles, grid)
        # The last tenths are undamped: what is left at rest is rest.
        keep = 1.0 - SETTLE_DAMPING * dt if part < 8 else 1.0
        solver.advance(
            particles,
            work,
            None,
            grid.shape,
            grid.origin,
            grid.dx,
            dt,
            grid.walls,
            soil,
            particle_volume(box),
            EARTH_GRAVITY,
            keep,
            None,
            np.zeros((steps // 10 + 1, 3)),
            np.zeros(0),
            np.zeros(3),
            np.zeros(6),
            status,
        )
    particles = in_identity_order(particles)
    speed = float(np.linalg.norm(particles[:, columns.V : columns.V + 3], axis=1).max())
    if status[0] != columns.OK or not speed < REST_SPEED:
        raise ValueError(f'the packing does not settle: status {status[0]}, speed {speed:.3g} m/s')
    particles[:, columns.V : columns.S] = 0.0
    ratio = particles[:, columns.VOLUME_RATIO]
    statistics = {
        'seed': seed,
        'particles': len(particles),
        'particles_per_cell': grid.dx**3 / particle_volume(box),
        'jitter_of_spacing': JITTER,
        'settle_time_s': SETTLE_TIME,
        'speed_at_end_m_s': speed,
        'settled_by_mm': float(1e3 * (start[:, 1] - particles[:, 1]).mean()),
        'volume_ratio_min': float(ratio.min()),
        'volume_ratio_max': float(ratio.max()),
        'bulk_density_kg_m3': soil.bulk_density,
        'bulk_modulus_Pa': soil.bulk_modulus,
    }
    return particles, statistics


def settled(box: Bin, soil: Soil, seed: int, folder: str) -> tuple[np.ndarray, dict]:
    """Returns the packing kept in `folder`, which is made and kept there if it is absent.

    Raises:
        ValueError: if the one kept there has another seed, size or stiffness.
    """
    path = os.path.join(folder, PACKING_FILE)
    if not os.path.exists(path):
        particles, statistics = settle(box, soil, seed)
        write_arrays(path, particles=particles, statistics=np.array(json.dumps(statistics)))
    arrays = read_arrays(path)
    particles, statistics = arrays['particles'], json.loads(str(arrays['statistics']))
    asked = {
        'seed': seed,
        'particles': int(np.prod(box.lattice)),
        'bulk_modulus_Pa': soil.bulk_modulus,
    }
    kept = {name: statistics[name] for name in asked}
    if kept != asked:
        raise ValueError(f'{path} holds the packing of {kept}, not {asked}; name another folder')
    return particles, statistics


def at_gravity(particles: np.ndarray, gravity: float) -> np.ndarray:
    """Returns a copy of a settled soil with its stress scaled to another gravity (m/s2)."""
    particles = particles.copy()
    scale = gravity / EARTH_GRAVITY
    particles[:, columns.S : columns.S + 6] *= scale
    ratio = particles[:, columns.VOLUME_RATIO]
    compressed = ratio < 1.0
    # The pressure is K (1 / ratio - 1): scale that.
    ratio[compressed] = 1.0 / (1.0 + scale * (1.0 / ratio[compressed] - 1.0))
    return particles


def sort_by_cell(particles: np.ndarray, grid: Grid) -> np.ndarray:
    """Returns the particles ordered by cell, which keeps the kernels in the cache."""
    i, j, k = np.floor((particles[:, :3] - grid.origin) / grid.dx).astype(np.int64).T
    return particles[np.argsort((j * grid.shape[0] + i) * grid.shape[2] + k, kind='stable')]


def in_identity_order(particles: np.ndarray) -> np.ndarray:
    """Returns the particles in the order of their identity: particle i is row i."""
    ordered = np.empty_like(particles)
    ordered[particles[:, columns.IDENTITY].astype(np.int64)] = particles
    return ordered
