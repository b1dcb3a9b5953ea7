"""Transfers, eqs. (1) to (4), against a plain numpy twin, and what they must conserve."""

import numpy as np
import pytest

from mpm import columns, experiments, packing
from mpm.constitutive import Soil
from mpm.grid import make_grid
from mpm.scenes import CORNER, Bin
from mpm.solver import make_block, make_nodes
from mpm.transfers import (
    grid_to_particles,
    particles_to_grid,
    return_elastic,
    strain_and_force,
)

# Cells half as long again across, as those of the scenes are longer.
BOX = Bin((0.1, 0.1, 0.12), 0.02, 0.03, (6, 6, 6), 1, 0.1, ())
GRID = make_grid(BOX)
VOLUME = packing.particle_volume(BOX)
DT = 1e-4
TYPES = [np.float64, np.float32]


@pytest.fixture
def particles(soil):
    """A block with random velocities, gradients and stresses."""
    rows = packing.lattice(BOX, seed=3)
    rng = np.random.default_rng(4)
    rows[:, columns.V : columns.VOLUME_RATIO] = rng.normal(size=(len(rows), 18))
    rows[:, columns.S : columns.S + 3] -= rows[:, columns.S : columns.S + 3].mean(axis=1)[:, None]
    rows[:, columns.VOLUME_RATIO] = rng.uniform(0.98, 1.02, len(rows))
    return rows


def scatter(particles, soil, half_step=DT, grid=GRID, dtype=np.float64):
    """Returns the block, its nodes and the box; nodes carry momentum and mass."""
    block, nodes = make_block(particles, dtype), make_nodes(grid, dtype)
    status = np.zeros(2, dtype=np.int64)
    mass = VOLUME * soil.bulk_density
    box = particles_to_grid(
        block, nodes.velocity, grid, half_step, mass, VOLUME, soil.bulk_modulus, status
    )
    assert status[0] == columns.OK
    return block, nodes, box


def rows_of(block):
    """The rows of the particles in the middle of an interval, stress and strain included."""
    for n in range(len(block.particles)):
        return_elastic(block, n)
    return block.particles


def field(nodes):
    """A node array [4 nodes] as [y, x, z, 4]."""
    nx, ny, nz = GRID.shape
    return nodes.reshape(ny, nx, nz, 4)


def places():
    """Positions of the nodes, [y, x, z, 3]."""
    x, y, z = (GRID.origin[a] + np.arange(GRID.shape[a]) * GRID.cell[a] for a in range(3))
    j, i, k = np.meshgrid(y, x, z, indexing='ij')
    return np.stack([i, j, k], axis=-1)


def spline(distance):
    """The quadratic B-spline of a distance in cells."""
    d = np.abs(distance)
    return np.where(d < 0.5, 0.75 - d**2, np.where(d < 1.5, 0.5 * (1.5 - d) ** 2, 0.0))


def weights_of(row):
    """Weight of every node for a particle [y, x, z], and the way to it [y, x, z, 3]."""
    offset = places() - row[:3]
    return spline(offset / GRID.cell).prod(axis=-1), offset


def stress_of(row, soil: Soil):
    """Cauchy stress [3, 3] that a particle carries."""
    s = row[columns.S : columns.S + 6]
    pressure = max(soil.bulk_modulus * (1.0 / row[columns.VOLUME_RATIO] - 1.0), 0.0)
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


@pytest.mark.parametrize('dtype', TYPES)
def test_scatter_equals_its_definition(particles, soil, dtype):
    """Eq. (1), and the half kick of eq. (3)."""
    _, nodes, box = scatter(particles, soil, dtype=dtype)
    mass = VOLUME * soil.bulk_density
    expected = np.zeros(field(nodes.velocity).shape)
    for row in particles:
        weight, offset = weights_of(row)
        gradient = row[columns.C : columns.C + 9].reshape(3, 3)
        expected[..., :3] += weight[..., None] * mass * (row[3:6] + offset @ gradient.T)
        expected[..., 3] += weight * mass
    expected[..., :3] += DT * force_of(particles, [stress_of(row, soil) for row in particles])
    scale = np.abs(expected).max(axis=(0, 1, 2))
    # Sums of some 200 terms in another order: measured 2e-15.
    np.testing.assert_allclose(
        field(nodes.velocity) / scale, expected / scale, atol=500 * np.finfo(dtype).eps
    )
    outside = np.ones(expected.shape[:3], dtype=bool)
    outside[box[2] : box[3], box[0] : box[1], box[4] : box[5]] = False
    assert not expected[outside].any()


@pytest.mark.parametrize('in_one_cell', [False, True])
def test_mass_and_momentum_are_conserved(particles, soil, in_one_cell):
    if in_one_cell:
        particles[:, :3] = CORNER + 0.05  # all at one place
    _, nodes, _ = scatter(particles, soil)
    mass = VOLUME * soil.bulk_density
    found = field(nodes.velocity)
    assert found[..., 3].sum() == pytest.approx(mass * len(particles), rel=1e-12)
    momentum = mass * particles[:, columns.V : columns.V + 3].sum(axis=0)
    # Stress and gradient carry none; the forces that cancel are a thousand times larger.
    scale = np.abs(found[..., :3]).sum()
    np.testing.assert_allclose(found[..., :3].sum(axis=(0, 1, 2)), momentum, atol=1e-13 * scale)


def test_linear_field_is_taken_up_exactly(particles, soil):
    """Eq. (4): velocity, gradient and way of any linear field."""
    block, nodes, _ = scatter(particles, soil)
    rng = np.random.default_rng(5)
    velocity, gradient = rng.normal(size=3), rng.normal(size=(3, 3))
    field(nodes.velocity)[..., :3] = velocity + places() @ gradient.T
    nodes.displacement[:] = 1e-3 * nodes.velocity
    grid_to_particles(block, nodes.velocity, nodes.displacement, GRID)
    after, before = block.particles, particles[:, :3]
    expected = velocity + before @ gradient.T
    np.testing.assert_allclose(after[:, 3:6], expected, atol=1e-13)
    np.testing.assert_allclose(
        after[:, columns.C : columns.C + 9].reshape(-1, 3, 3),
        np.broadcast_to(gradient, (len(particles), 3, 3)),
        atol=1e-10,
    )
    np.testing.assert_allclose(after[:, :3], before + 1e-3 * expected, atol=1e-15)


@pytest.mark.parametrize('dtype', TYPES)
def test_gather_of_any_field_equals_its_definition(particles, soil, dtype):
    """Eqs. (2) and (4) on a random field."""
    block, nodes, _ = scatter(particles, soil, dtype=dtype)
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
def test_forces_are_those_of_the_new_stress(particles, soil, dtype):
    """Eq. (3) after the stress update, with and without the lead that damps."""
    damping = 2e-4
    block, nodes, _ = scatter(particles, soil, dtype=dtype)
    near = np.finfo(dtype).eps
    rng = np.random.default_rng(7)
    nodes.velocity[:] = 0.1 * rng.normal(size=nodes.velocity.shape)
    strain_and_force(block, nodes, GRID, DT, VOLUME, soil, damping)
    after = rows_of(block)
    assert (after[:, columns.VOLUME_RATIO] != particles[:, columns.VOLUME_RATIO]).all()
    stresses = []
    for old, new in zip(particles, after):
        stress, before = stress_of(new, soil), stress_of(old, soil)
        rate = (stress - before) / DT
        if new[columns.VOLUME_RATIO] >= 1.0:  # no pressure, no damping of it
            rate -= np.trace(rate) / 3.0 * np.eye(3)
        stresses.append(stress + damping * rate)
    expected = force_of(after, stresses)
    found = field(nodes.force)
    np.testing.assert_allclose(found[..., :3], expected, atol=5e3 * near * np.abs(expected).max())
    # Internal forces push nothing as a whole, and turn nothing: the stress is symmetric.
    scale = np.abs(found[..., :3]).sum()
    np.testing.assert_allclose(found[..., :3].sum(axis=(0, 1, 2)), 0.0, atol=50 * near * scale)
    moment = np.cross(places(), found[..., :3]).sum(axis=(0, 1, 2))
    np.testing.assert_allclose(moment, 0.0, atol=50 * near * scale)


def test_volume_follows_the_divergence(particles, soil):
    block, nodes, _ = scatter(particles, soil)
    nodes.velocity[:] = 0.0
    field(nodes.velocity)[..., 0] = 0.3 * places()[..., 0]
    strain_and_force(block, nodes, GRID, 1e-3, VOLUME, soil, 0.0)
    ratio = rows_of(block)[:, columns.VOLUME_RATIO] / particles[:, columns.VOLUME_RATIO]
    np.testing.assert_allclose(ratio, 1.0003, rtol=1e-12)


@pytest.mark.parametrize('axis', [0, 1, 2])
@pytest.mark.parametrize('place', [-1.0, 5.0, np.nan, np.inf])
def test_particle_off_the_grid_is_reported(particles, soil, axis, place):
    particles[7, axis] = place
    status = np.zeros(2, dtype=np.int64)
    nodes = make_nodes(GRID)
    particles_to_grid(
        make_block(particles), nodes.velocity, GRID, DT, 1.0, 1.0, soil.bulk_modulus, status
    )
    assert tuple(status) == (columns.LEFT_GRID, 7)
    experiment = experiments.Experiment(BOX, BOX, soil)
    experiment.particles[7, axis] = place
    with pytest.raises(ValueError, match='left the grid'):
        experiment.solver.advance(make_block(experiment.particles), 1, 0.0)
    # The work space is clean again.
    assert not experiment.solver.nodes.velocity.any() and not experiment.solver.nodes.force.any()


@pytest.mark.parametrize('ratio', [0.0, -1e-3, -0.9, np.nan])
def test_particle_turned_inside_out_is_reported(particles, soil, ratio):
    experiment = experiments.Experiment(BOX, BOX, soil)
    experiment.particles[7, columns.VOLUME_RATIO] = ratio
    with pytest.raises(ValueError, match='inside out at'):
        experiment.advance(1e-3)


def test_an_exchange_keeps_momentum_and_moment(particles, soil):
    """Out to the nodes and back, with the affine part: sum m (x x v + eps : (C D))."""
    mass, inertia = VOLUME * soil.bulk_density, GRID.cell**2 / 4.0

    def moment(rows, at):
        spin = rows[:, columns.C : columns.C + 9].reshape(-1, 3, 3) * inertia
        turn = [spin[:, 2, 1] - spin[:, 1, 2], spin[:, 0, 2] - spin[:, 2, 0]]
        turn = np.stack([*turn, spin[:, 1, 0] - spin[:, 0, 1]], axis=1)
        return mass * (np.cross(at, rows[:, 3:6]) + turn).sum(axis=0)

    block, nodes, _ = scatter(particles, soil, half_step=0.0)
    total = field(nodes.velocity)
    np.testing.assert_allclose(
        np.cross(places(), total[..., :3]).sum(axis=(0, 1, 2)), moment(particles, particles[:, :3]),
        rtol=1e-12,
    )  # fmt: skip
    weight = total[..., 3:]
    total[..., :3] = np.where(weight > 0.0, total[..., :3] / np.where(weight > 0.0, weight, 1.0), 0)
    grid_to_particles(block, nodes.velocity, nodes.displacement, GRID)
    after = block.particles
    np.testing.assert_allclose(after[:, 3:6].sum(axis=0), particles[:, 3:6].sum(axis=0), atol=1e-11)
    np.testing.assert_allclose(
        moment(after, particles[:, :3]), moment(particles, particles[:, :3]), rtol=1e-10
    )
