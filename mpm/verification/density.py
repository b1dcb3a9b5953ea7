"""How densely soil is packed, by counting: the law knows but the volume that a particle states."""

import numpy as np

from mpm import scenes
from mpm.bodies import signed_distances
from mpm.simulation import Settings
from mpm.verification.convergence import drive, packed
from mpm.verification.rows import Check
from mpm.verification.surfaces import surface

RADIUS = 0.03  # m, of the spheres in which particles are counted: 40 of them
APART = 0.015  # m, between the middles of spheres
MOVED = 0.03  # m, from where soil counts as moved


def spheres(positions: np.ndarray, box: scenes.Bin) -> np.ndarray:
    """Returns the middles [M, 3] (m) of spheres on a lattice that lie in the soil [N, 3] (m)."""
    height = surface(positions, box)
    nx, nz = height.shape
    # A surface sees half a square beyond the next one: the lowest of five by five is below it.
    around = np.pad(height, 2, mode='edge')
    lowest = np.min([around[i : i + nx, k : k + nz] for i in range(5) for k in range(5)], axis=0)
    high = [box.size[0], positions[:, 1].max() - scenes.CORNER, box.size[2]]
    axes = [np.arange(RADIUS, end - RADIUS, APART) for end in high]
    places = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 3)
    across = places[:, [0, 2]] / [box.size[0], box.size[2]] * height.shape
    is_deep = places[:, 1] + scenes.CORNER < lowest[tuple(across.astype(int).T)] - RADIUS
    return places[is_deep] + scenes.CORNER


def count(positions: np.ndarray, middles: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Counts the particles [N, 3] in each of M spheres, and sums up their `values` [N].

    Returns:
        Numbers and sums, float64 [2, M].
    """
    order = np.argsort(positions[:, 0])
    x, values = positions[order], values[order]
    found = np.zeros((2, len(middles)))
    for column in np.unique(middles[:, 0]):
        first, last = np.searchsorted(x[:, 0], [column - RADIUS, column + RADIUS])
        for m in np.flatnonzero(middles[:, 0] == column):
            is_in = ((x[first:last] - middles[m]) ** 2).sum(axis=1) < RADIUS**2
            found[:, m] = np.count_nonzero(is_in), values[first:last][is_in].sum()
    return found


def moved_density(start: np.ndarray, end: np.ndarray, simulation) -> float | None:
    """Returns the density of soil that moved over that of the bed before; None: too little moved.

    Args:
        start, end: float64 [N, 3], places of all particles, m.
        simulation: `Simulation` at the end, whose body is left out.
    """
    box = simulation.box
    way = np.linalg.norm(end - start, axis=1)
    before, _ = count(start, spheres(start, box), way)
    middles = spheres(end, box)
    if not len(middles) or not len(before):
        return None
    away = signed_distances(simulation.drive.body, simulation.pose, middles)
    after, ways = count(end, middles[away > RADIUS], way)
    is_moved = ways > MOVED * after
    return float(after[is_moved].mean() / before.mean()) if is_moved.sum() > 5 else None


def moved_soil(case: int, frames: int) -> list[Check]:
    """The density of soil that a blade has moved, over that of the bed before."""
    scene, settings = scenes.EXCAVATION, Settings()
    start = packed(scene.bin, settings.youngs_modulus)[:, :3]
    _, simulation = drive(scene, case, frames, settings)
    density = moved_density(start, simulation.positions(), simulation)
    name = f'excavation {case}: density of soil that moved over {1e3 * MOVED:.0f} mm'
    return [Check(name, density, 1.005, 0.025, f'{frames} frames, over that of the bed')]
