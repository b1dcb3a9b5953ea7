"""Transfers, eqs. (1) to (4), against a plain numpy twin, and what they must conserve."""

import re

import numpy as np
import pytest

from mpm import columns, experiments, packing
from mpm.grid import make_grid
from mpm.scenes import Bin
from mpm.solver import make_block, make_nodes
from mpm.transfers import grid_to_particles, particles_to_grid, return_elastic, strain_and_force
from tests.mpm.small import SOIL, spline

# Cells half as long again across, as those of the scenes are longer.
BOX = Bin((0.1, 0.1, 0.12), 0.02, 0.03, (6, 6, 6), 1, 0.1, ())
GRID = make_grid(BOX)
VOLUME = packing.particle_volume(BOX)
DT = 1e-4
TYPES = [np.float64, np.float32]


@pytest.fixture
def particles():
    """A block with random velocities, gradients and stresses."""
    rows = packing.lattice(BOX, seed=3)
    rng = np.random.default_rng(4)
    rows[:, columns.V : columns.VOLUME_RATIO] = rng.normal(size=(len(rows), 18))
    rows[:, columns.S : columns.S + 3] -= rows[:, columns.S : columns.S + 3].mean(axis=1)[:, None]
    rows[:, columns.VOLUME_RATIO] = rng.uniform(0.98, 1.02, len(rows))
    return rows


def scatter(particles, dtype=np.float64):
    """Returns the block, its nodes and the box; nodes carry momentum and mass."""
    block, nodes = make_block(particles, dtype), make_nodes(GRID, dtype)
    status = np.zeros(2, dtype=np.int64)
    box = particles_to_grid(block, nodes.velocity, GRID, DT, VOLUME, SOIL, status)
    assert status[0] == columns.OK
    return block, nodes, box


def field(nodes):
    """A node array [4 nodes] as [y, x, z, 4]."""
    nx, ny, nz = GRID.shape
    return nodes.reshape(ny, nx, nz, 4)


def places():
    """Positions of the nodes, [y, x, z, 3]."""
    x, y, z = (GRID.origin[a] + np.arange(GRID.shape[a]) * GRID.cell[a] for a in range(3))
    j, i, k = np.meshgrid(y, x, z, indexing='ij')
    return np.stack([i, j, k], axis=-1)


def weights_of(row):
    """Weight of every node for a particle [y, x, z], and the way to it [y, x, z, 3]."""
    offset = places() - row[:3]
    return spline(offset / GRID.cell).prod(axis=-1), offset


def stress_of(row):
    """Cauchy stress [3, 3] that a particle carries."""
    s = row[columns.S : columns.S + 6]
    pressure = max(SOIL.bulk_modulus * (1.0 / row[columns.VOLUME_RATIO] - 1.0), 0.0)
    stress = np.array([[s[0], s[3], s[5]], [s[3], s[1], s[4]], [s[5], s[4], s[2]]])
    return stress - pressure * np.eye(3)


def force_of(rows, stresses):
    """Eq. (3) from its definition: all nodes against all particles, [y, x, z, 3]."""
    total = 0.0
    for row, stress in zip(rows, stresses):
        weight, offset = weights_of(row)
        volume = VOLUME * row[columns.VOLUME_RATIO]
        total = total - weight[..., None] * ((offset * 4.0 / GRID.cell**2) @ (volume * stress.T))
    return total


@pytest.mark.parametrize('in_one_place', [False, True])
@pytest.mark.parametrize('dtype', TYPES)
def test_scatter_equals_its_definition(particles, dtype, in_one_place):
    """Eq. (1), and the half kick of eq. (3)."""
    if in_one_place:
        particles[:, :3] = BOX.surface - 0.05
    _, nodes, box = scatter(particles, dtype=dtype)
    mass = VOLUME * SOIL.bulk_density
    expected = np.zeros(field(nodes.velocity).shape)
    for row in particles:
        weight, offset = weights_of(row)
        gradient = row[columns.C : columns.C + 9].reshape(3, 3)
        expected[..., :3] += weight[..., None] * mass * (row[3:6] + offset @ gradient.T)
        expected[..., 3] += weight * mass
    expected[..., :3] += DT * force_of(particles, [stress_of(row) for row in particles])
    scale = np.abs(expected).max(axis=(0, 1, 2))
    # Sums of some 200 terms in another order: measured 2e-15.
    np.testing.assert_allclose(
        field(nodes.velocity) / scale, expected / scale, atol=500 * np.finfo(dtype).eps
    )
    outside = np.ones(expected.shape[:3], dtype=bool)
    outside[box[2] : box[3], box[0] : box[1], box[4] : box[5]] = False
    assert not expected[outside].any()


@pytest.mark.parametrize('dtype', TYPES)
def test_gather_of_any_field_equals_its_definition(particles, dtype):
    """Eqs. (2) and (4) on a random field."""
    block, nodes, _ = scatter(particles, dtype=dtype)
    near = np.finfo(dtype).eps
    rng = np.random.default_rng(6)
    nodes.velocity[:] = rng.normal(size=nodes.velocity.shape)
    nodes.displacement[:] = 1e-3 * rng.normal(size=nodes.velocity.shape)
    grid_to_particles(block, nodes.velocity, nodes.displacement, GRID)
    v, u = field(nodes.velocity)[..., :3], field(nodes.displacement)[..., :3]
    for row, after in zip(particles[::7], block.particles[::7]):
        weight, offset = weights_of(row)
        gradient = np.einsum('jik,jika,jikb->ab', weight, v, offset) * 4.0 / GRID.cell**2
        np.testing.assert_allclose(after[6:15].reshape(3, 3), gradient, atol=5e4 * near)
        np.testing.assert_allclose(after[3:6], np.einsum('jik,jika->a', weight, v), atol=50 * near)
        moved = row[:3] + np.einsum('jik,jika->a', weight, u)
        np.testing.assert_allclose(after[:3], moved, atol=max(near * 1e-2, 1e-15))


@pytest.mark.parametrize('dtype', TYPES)
def test_forces_are_those_of_the_new_stress(particles, dtype):
    """Eq. (3) after the stress update, with and without the lead that damps."""
    damping = 2e-4
    block, nodes, _ = scatter(particles, dtype=dtype)
    near = np.finfo(dtype).eps
    rng = np.random.default_rng(7)
    nodes.velocity[:] = 0.1 * rng.normal(size=nodes.velocity.shape)
    strain_and_force(block, nodes, GRID, DT, VOLUME, SOIL, damping)
    for n in range(len(particles)):  # an interval would do so at its end
        return_elastic(block, n)
    after = block.particles
    assert (after[:, columns.VOLUME_RATIO] != particles[:, columns.VOLUME_RATIO]).all()
    stresses = []
    for old, new in zip(particles, after):
        stress, before = stress_of(new), stress_of(old)
        rate = (stress - before) / DT
        if new[columns.VOLUME_RATIO] >= 1.0:  # no pressure, no damping of it
            rate -= np.trace(rate) / 3.0 * np.eye(3)
        stresses.append(stress + damping * rate)
    expected, found = force_of(after, stresses), field(nodes.force)[..., :3]
    np.testing.assert_allclose(found, expected, atol=5e3 * near * np.abs(expected).max())
    # Internal forces push nothing as a whole, and turn nothing: the stress is symmetric.
    scale = np.abs(found).sum()
    np.testing.assert_allclose(found.sum(axis=(0, 1, 2)), 0.0, atol=50 * near * scale)
    moment = np.cross(places(), found).sum(axis=(0, 1, 2))
    np.testing.assert_allclose(moment, 0.0, atol=50 * near * scale)


@pytest.mark.parametrize(
    ('column', 'values', 'words'),
    [
        *((axis, (-1.0, 5.0, np.nan, np.inf), 'left the grid') for axis in range(3)),
        (columns.VOLUME_RATIO, (0.0, -1e-3, -0.9, np.nan), 'was turned inside out'),
    ],
)
def test_particle_off_the_grid_or_turned_inside_out_is_reported(column, values, words):
    for value in values:
        experiment = experiments.Experiment(BOX, BOX, SOIL)
        experiment.particles[7, column] = value
        place = re.escape(str(experiment.particles[7, :3]))
        with pytest.raises(ValueError, match=f'a particle {words} at {place} m'):
            experiment.solver.advance(make_block(experiment.particles), 1, 0.0)
        nodes = experiment.solver.nodes  # the work space is clean again
        assert not nodes.velocity.any() and not nodes.force.any()


def angular_momentum(rows):
    """About the origin, over the mass of a particle, with what turns inside of each: [3]."""
    axes = np.eye(3)
    turns = np.cross(axes[:, None], axes)  # e_b x e_c
    gradients = rows[:, columns.C : columns.C + 9].reshape(-1, 3, 3)
    inner = np.einsum('bca,b,pcb->a', turns, GRID.cell**2 / 4.0, gradients)
    return np.cross(rows[:, :3], rows[:, 3:6]).sum(axis=0) + inner


def test_an_exchange_keeps_momentum_and_moment(particles):
    """On cells that are longer across; soil without stress that moves on for a while."""
    particles[:, columns.S : columns.S + 6] = 0.0
    particles[:, columns.VOLUME_RATIO] = 1.0
    momentum, moment = particles[:, 3:6].sum(axis=0), angular_momentum(particles)
    block, nodes, _ = scatter(particles)
    carried = field(nodes.velocity)
    has_mass = carried[..., 3] > 0
    carried[has_mass, :3] /= carried[has_mass, 3:]
    nodes.displacement[:] = 1e-3 * nodes.velocity
    grid_to_particles(block, nodes.velocity, nodes.displacement, GRID)
    after = block.particles
    assert np.abs(after[:, 3:6] - particles[:, 3:6]).max() > 0.1
    scale = np.abs(particles[:, 3:6]).sum()
    np.testing.assert_allclose(after[:, 3:6].sum(axis=0), momentum, atol=1e-15 * scale)
    np.testing.assert_allclose(angular_momentum(after), moment, atol=1e-15 * scale)
