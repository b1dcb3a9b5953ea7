"""What is measured of a bed of soil: the height of its surface, its density, what it carries."""

import numpy as np
from scipy.ndimage import minimum_filter
from scipy.spatial import cKDTree

from mpm import columns, packing
from mpm.constitutive import Soil
from mpm.distance import signed_distances
from mpm.grid import make_grid, start_nodes
from mpm.scenes import CORNER, EARTH_GRAVITY, Bin
from mpm.solver import make_block, make_nodes
from mpm.transfers import particles_to_grid

SIDE = 0.027  # m, of the squares, about; two spacings of the particles of the excavation
RADIUS = 0.03  # m, of the spheres in which particles are counted: 40 of them
APART = 0.015  # m, between the middles of spheres
MOVED = 0.03  # m, from where soil counts as moved


def surface(positions: np.ndarray, box: Bin) -> np.ndarray:
    """Returns the height [x, z] (m) of the surface of soil [N, 3] (m) over squares of `SIDE`.

    A column of soil up to the height h has for the integral of exp(y / l) dy over its particles
    l (exp(h / l) - 1); here that is solved for h, y over the floor, with l the side of a square. A
    particle has its packed volume, shared to nine squares by quadratic B-splines, those beyond a
    wall back to the wall's own. So it is the soil within about l of the surface that is seen, soil
    that is lowered by some way lowers its surface by that way, and no particle counts for all of a
    square: by the highest particle of each, one that crossed a border by a micrometre changed two
    squares by a layer.
    """
    across = np.array([box.size[0], box.size[2]])
    cells = np.round(across / SIDE).astype(int)
    side = across / cells
    place = (positions[:, [0, 2]] - CORNER) / side
    nearest = np.floor(place).astype(int)
    away = place - nearest - 0.5
    weights = np.stack([0.5 * (0.5 - away) ** 2, 0.75 - away**2, 0.5 * (0.5 + away) ** 2])
    volume = float(np.prod(box.size)) / len(positions)
    total = np.zeros(cells)
    share = volume / (side.prod() * SIDE) * np.exp((positions[:, 1] - CORNER) / SIDE)
    for i in range(3):
        for k in range(3):
            square = np.clip(nearest + [i - 1, k - 1], 0, cells - 1)
            np.add.at(total, tuple(square.T), share * weights[i, :, 0] * weights[k, :, 1])
    return CORNER + SIDE * np.log1p(total)


def spheres(positions: np.ndarray, box: Bin) -> np.ndarray:
    """Returns the middles [M, 3] (m) of spheres on a lattice that lie in the soil [N, 3] (m)."""
    height = surface(positions, box)
    # A surface sees half a square beyond the next one: the lowest of five by five is below it.
    lowest = minimum_filter(height, 5, mode='nearest')
    high = [box.size[0], positions[:, 1].max() - CORNER, box.size[2]]
    axes = [np.arange(RADIUS, end - RADIUS, APART) for end in high]
    places = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 3)
    across = places[:, [0, 2]] / [box.size[0], box.size[2]] * height.shape
    is_deep = places[:, 1] + CORNER < lowest[tuple(across.astype(int).T)] - RADIUS
    return places[is_deep] + CORNER


def count(positions: np.ndarray, middles: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Counts the particles [N, 3] in each of M spheres, and sums up their `values` [N]: float64 [2,
    M]."""
    inside = cKDTree(positions).query_ball_point(middles, RADIUS)
    return np.array([(len(rows), values[rows].sum()) for rows in inside], float).reshape(-1, 2).T


def moved_density(start: np.ndarray, end: np.ndarray, simulation) -> float | None:
    """Returns the density of soil that moved over that of the bed before; None: too little moved.

    `start` and `end` [N, 3] (m) are the places of all particles; the body of the `Simulation` at
    the end is left out.
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


def settled_soil(box: Bin, particles: np.ndarray, soil: Soil) -> dict:
    """Returns the reaction of walls and floor over the weight of a settled packing (particles), and
    in the middle of the bin the vertical stress over rho g h, apart for the soil above the lowest
    cell and within it: nodes below the floor are held, so the grid has no linear field there."""
    grid, nodes = make_grid(box), make_nodes(make_grid(box))
    volume = packing.particle_volume(box)
    mass = volume * soil.bulk_density
    status = np.zeros(2, dtype=np.int64)
    # Half a step of one second: what is scattered is half the force, in N.
    block = make_block(particles)
    extent = particles_to_grid(block, nodes.velocity, grid, 0.5, volume, soil, status)
    before = nodes.velocity.reshape(-1, 4).copy()
    free, _ = start_nodes(nodes, grid, extent, 0.0, 0.0)
    held = before[:, 3] > 0.0
    held[nodes.free[:free] // 4] = False
    # What the walls take, and the weight of the soil that sits on their own nodes.
    reaction = -before[held, 1].sum() / 0.5 + before[held, 3].sum() * EARTH_GRAVITY
    across = np.array(box.size)[[0, 2]]
    middle = np.abs(particles[:, [0, 2]] - CORNER - across / 2)
    is_inner = (middle < across / 2 - box.size[1]).all(axis=1)
    is_low = particles[:, 1] < CORNER + box.dx
    pressure = soil.bulk_modulus * np.maximum(1.0 / particles[:, columns.VOLUME_RATIO] - 1.0, 0.0)
    stress = pressure - particles[:, columns.S + 1]
    overburden = soil.bulk_density * EARTH_GRAVITY * (box.surface - particles[:, 1])

    def ratio(chosen):
        return float((stress * overburden)[chosen].sum() / (overburden**2)[chosen].sum())

    return {
        'reaction_over_weight': float(reaction / (len(particles) * mass * EARTH_GRAVITY)),
        'stress_over_rho_g_h': ratio(is_inner & ~is_low),
        'stress_at_floor_over_rho_g_h': ratio(is_inner & is_low),
    }
