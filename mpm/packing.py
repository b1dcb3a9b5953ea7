"""The settled soil from which every run of a scene starts.

Blade forces depend on the packing more than on anything else, so there is one per scene: a
staggered, jittered lattice (seeded), settled under gravity until it rests. It fixes number and
order of the particles of all runs. The settled stress is elastic; at another gravity it scales.
"""

import json
import math
import os

import numpy as np

from mpm import columns
from mpm.constitutive import PACKED_DENSITY, Soil, make_soil
from mpm.grid import Grid, make_grid
from mpm.scenes import CORNER, EARTH_GRAVITY, PACKING_MU_S, Bin
from mpm.solver import EXCHANGE, Solver
from pca_tools.files import read_npz, write_npz

PACKING_FILE = 'packing.npz'
JITTER = 0.1  # of the lattice spacing, half width of the uniform jitter
STAGGER = 0.8  # of the spacing, by which columns stand higher or lower; no grain above the surface
INVERSE_GOLDEN = 0.6180339887498949
INVERSE_PLASTIC = (0.7548776662466927, 0.5698402909980532)  # and its square
SETTLE_TIME = 0.05  # s
SETTLE_DAMPING = 200.0  # 1/s
REST_SPEED = 0.02  # m/s, largest speed of a settled soil


def particle_volume(box: Bin) -> float:
    """Returns the packed volume of soil per particle, m3."""
    return float(np.prod(box.size)) / float(np.prod(box.lattice))


def lattice(box: Bin, seed: int) -> np.ndarray:
    """Returns the unsettled particle array [N, COLUMNS], free of stress.

    A lattice whose planes across z are staggered: plane k is shifted along x, and each column of it
    along y, by the terms of a low-discrepancy sequence (multiples of the inverse golden ratio; of
    those of the plastic number). So a blade that spans 30 planes meets the layers of particles one
    after another. Unshifted, all planes met it at once and the force swung by a third while the
    blade went down. Then a seeded jitter.
    """
    spacing = np.array(box.size) / box.lattice
    i, j, k = np.meshgrid(*(np.arange(n) for n in box.lattice), indexing='ij')
    x = np.mod(i + np.mod(k * INVERSE_GOLDEN, 1.0), box.lattice[0])
    y = j + 0.5 + STAGGER * (np.mod(i * INVERSE_PLASTIC[1] + k * INVERSE_PLASTIC[0], 1.0) - 0.5)
    positions = np.stack([x, y, k + 0.5], axis=-1).reshape(-1, 3)
    positions += np.random.default_rng(seed).uniform(-JITTER, JITTER, positions.shape)
    # A jittered plane at the end of the bin would stand in the wall.
    positions[:, 0] = np.clip(positions[:, 0], 1e-3, box.lattice[0] - 1e-3)
    particles = np.zeros((len(positions), columns.COLUMNS))
    particles[:, :3] = CORNER + positions * spacing
    particles[:, columns.VOLUME_RATIO] = 1.0
    return particles


def at_rest(particles: np.ndarray, soil: Soil, surface: float, gravity: float) -> np.ndarray:
    """Returns a copy with the stress of soil at rest under a flat surface (m).

    Elastic soil that cannot give way sideways carries sigma_h = K0 sigma_v with
    K0 = nu / (1 - nu), and sigma_v = rho g depth.
    """
    particles = particles.copy()
    k, g = soil.bulk_modulus, soil.shear_modulus
    k0 = (3.0 * k - 2.0 * g) / (3.0 * k + 4.0 * g)
    vertical = soil.bulk_density * gravity * np.maximum(surface - particles[:, 1], 0.0)
    pressure = vertical * (1.0 + 2.0 * k0) / 3.0
    particles[:, columns.S] = particles[:, columns.S + 2] = pressure - k0 * vertical
    particles[:, columns.S + 1] = pressure - vertical
    particles[:, columns.VOLUME_RATIO] = 1.0 / (1.0 + pressure / soil.bulk_modulus)
    return particles


def settle(box: Bin, youngs_modulus: float, seed: int) -> tuple[np.ndarray, dict]:
    """Gives the lattice of a soil (Young's modulus in Pa) the stress of soil at rest on the Earth,
    and lets it settle.

    Returns the particle array [N, COLUMNS], at rest, and its statistics. ValueError: the soil does
    not come to rest, or a step fails (`Solver.advance`).
    """
    grid, soil = make_grid(box), make_soil(youngs_modulus, PACKING_MU_S)
    particles = at_rest(lattice(box, seed), soil, box.surface, EARTH_GRAVITY)
    start = particles[:, :3].copy()
    solver = Solver(grid, soil, particle_volume(box))
    order = cell_order(particles, grid)
    block = solver.block(particles[order])
    intervals = math.ceil(SETTLE_TIME / EXCHANGE / 10)
    settling = 1.0 - SETTLE_DAMPING * solver.dt
    for part in range(10):
        # The last tenths are undamped: what is left at rest is rest.
        solver.advance(block, intervals, EARTH_GRAVITY, settling if part < 8 else 1.0)
    particles[order] = block.particles
    speed = float(np.linalg.norm(particles[:, columns.V : columns.V + 3], axis=1).max())
    if not speed < REST_SPEED:
        raise ValueError(f'the packing does not settle: its fastest particle has {speed:.3g} m/s')
    particles[:, columns.V : columns.S] = 0.0
    ratio = particles[:, columns.VOLUME_RATIO]
    statistics = {
        'seed': seed,
        'particles': len(particles),
        'particles_per_cell': float(grid.cell.prod()) / particle_volume(box),
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


def settled(box: Bin, youngs_modulus: float, seed: int, folder: str) -> tuple[np.ndarray, dict]:
    """Returns the packing (`settle`) kept in `folder`, which is made if absent; ValueError: the one
    kept there has another seed, size or stiffness."""
    path = os.path.join(folder, PACKING_FILE)
    if not os.path.exists(path):
        particles, statistics = settle(box, youngs_modulus, seed)
        write_npz(path, particles=particles, statistics=np.array(json.dumps(statistics)))
    arrays = read_npz(path)
    particles, statistics = arrays['particles'], json.loads(str(arrays['statistics']))
    asked = {
        'seed': seed,
        'particles': int(np.prod(box.lattice)),
        'bulk_modulus_Pa': make_soil(youngs_modulus, PACKING_MU_S).bulk_modulus,
    }
    kept = {name: statistics[name] for name in asked}
    if kept != asked:
        raise ValueError(f'{path} holds the packing of {kept}, not {asked}; name another folder')
    return particles, statistics


def for_soil(particles: np.ndarray, soil: Soil, gravity: float) -> np.ndarray:
    """Returns a copy of a settled soil with its stress as of another density and gravity (m/s2).

    The stress at rest is elastic and in proportion to rho g.
    """
    particles = particles.copy()
    scale = gravity / EARTH_GRAVITY * soil.bulk_density / PACKED_DENSITY
    particles[:, columns.S : columns.S + 6] *= scale
    ratio = particles[:, columns.VOLUME_RATIO]
    compressed = ratio < 1.0
    # The pressure is K (1 / ratio - 1): scale that.
    ratio[compressed] = 1.0 / (1.0 + scale * (1.0 / ratio[compressed] - 1.0))
    return particles


def cell_order(particles: np.ndarray, grid: Grid) -> np.ndarray:
    """Returns the indices that sort particles as their first nodes lie in the memory.

    Kernels then walk through the grid once: a fifth faster than in the order of cells.
    """
    i, j, k = np.floor((particles[:, :3] - grid.origin) / grid.cell - 0.5).astype(np.int64).T
    return np.argsort((j * grid.shape[0] + i) * grid.shape[2] + k, kind='stable')
