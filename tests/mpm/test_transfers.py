"""Transfers, eqs. (1) to (4), against a plain numpy twin, and what they must conserve."""

import numpy as np
import pytest

from mpm import columns, experiments, fluidity, packing
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

BOX = Bin((0.1, 0.1, 0.1), 0.02, (6, 6, 6), 1, 0.1, ())
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
    x, y, z = (GRID.origin[a] + np.arange(GRID.shape[a]) * GRID.dx for a in range(3))
    j, i, k = np.meshgrid(y, x, z, indexing='ij')
    return np.stack([i, j, k], axis=-1)


def spline(distance):
    """The quadratic B-spline of a distance in cells."""
    d = np.abs(distance)
    return np.where(d < 0.5, 0.75 - d**2, np.where(d < 1.5, 0.5 * (1.5 - d) ** 2, 0.0))


def weights_of(row):
    """Weight of every node for a particle [y, x, z], and the way to it [y, x, z, 3]."""
    offset = places() - row[:3]
    return spline(offset / GRID.dx).prod(axis=-1), offset


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
        total = total - weight[..., None] * (offset @ (volume * 4.0 / GRID.dx**2 * stress.T))
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


def test_mass_and_momentum_are_conserved(particles, soil):
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
    grid_to_particles(block, nodes.velocity, nodes.displacement, GRID, 1e-3, soil)
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
    grid_to_particles(block, nodes.velocity, nodes.displacement, GRID, 1e-3, soil)
    v, u = field(nodes.velocity)[..., :3], field(nodes.displacement)[..., :3]
    for row, after in zip(particles[::7], block.particles[::7]):
        weight, offset = weights_of(row)
        gradient = np.einsum('jik,jika,jikb->ab', weight, v, offset) * 4.0 / GRID.dx**2
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
    strain_and_force(block, nodes, GRID, DT, VOLUME, soil, damping, None)
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
    strain_and_force(block, nodes, GRID, 1e-3, VOLUME, soil, 0.0, None)
    ratio = rows_of(block)[:, columns.VOLUME_RATIO] / particles[:, columns.VOLUME_RATIO]
    np.testing.assert_allclose(ratio, 1.0003, rtol=1e-12)


def test_coincident_particles_and_one_full_cell(soil):
    particles = packing.lattice(BOX, seed=0)
    particles[:, :3] = CORNER + 0.05
    _, nodes, _ = scatter(particles, soil)
    assert np.isfinite(nodes.velocity).all()
    total = VOLUME * soil.bulk_density * len(particles)
    assert field(nodes.velocity)[..., 3].sum() == pytest.approx(total, rel=1e-12)


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


@pytest.mark.parametrize('ratio', [0.0, -0.5, np.nan])
def test_particle_turned_inside_out_is_reported(particles, soil, ratio):
    experiment = experiments.Experiment(BOX, BOX, soil)
    experiment.particles[7, columns.VOLUME_RATIO] = ratio
    with pytest.raises(ValueError, match='inside out'):
        experiment.advance(1e-3)


def test_fluidity_spreads_as_the_laplacian_says(soil):
    """A cosine keeps its shape and decays; the sum is conserved."""
    particles = packing.lattice(BOX, seed=0)
    wave = 2 * np.pi / 0.1
    particles[:, columns.FLUIDITY] = 1.0 + 0.1 * np.cos(wave * (particles[:, 0] - CORNER))
    block, _, box = scatter(particles, soil)
    work = np.zeros((GRID.nodes, 3))
    strong = soil._replace(nonlocal_amplitude=20.0)
    fluidity.diffuse_fluidity(block, work, GRID, box, DT, strong)
    nx, ny, nz = GRID.shape
    mass, value, change = work.reshape(ny, nx, nz, 3).transpose(3, 0, 1, 2)
    rate = DT * (20.0 * soil.grain_diameter) ** 2 / soil.nonlocal_time
    laplacian = sum(np.roll(value, s, axis) - value for axis in range(3) for s in (1, -1))
    inside = (slice(4, 8),) * 3
    assert (mass[3:9, 3:9, 3:9] > 0.0).all()
    np.testing.assert_allclose(change[inside], rate * laplacian[inside] / GRID.dx**2, atol=1e-14)
    # Nothing is lost: what one node gives, its neighbour takes.
    assert abs(change.sum()) < 1e-13
    # And the discrete one is the analytic one within the smoothing of the cells and the jitter.
    shape = (value[inside] - 1.0).mean(axis=(0, 2))
    expected = -rate * wave**2 * shape
    np.testing.assert_allclose(change[inside].mean(axis=(0, 2)), expected, rtol=0.3)
    # Particles take the increment of their nodes.
    for n in range(0, len(particles), 31):
        weight, _ = weights_of(particles[n])
        gained = block.particles[n, columns.FLUIDITY] - particles[n, columns.FLUIDITY]
        assert gained == pytest.approx((weight * change).sum(), abs=1e-14)


def test_dilation_counts_the_soil_on_the_grid(soil):
    """Eq. (7): shear rate and density against numpy, on a bed that is packed 10 % too closely."""
    soil = soil._replace(dilation=4.0)
    bed = packing.lattice(BOX, seed=3)
    middle = CORNER + 0.5 * BOX.size[0]
    bed[:, :3] = middle + (bed[:, :3] - middle) / 1.1 ** (1 / 3)
    block, nodes, _ = scatter(bed, soil)
    mass = field(nodes.velocity)[..., 3].copy()
    nodes.velocity.reshape(-1, 4)[:, 3] = np.where(
        mass > 0, 1.0 / np.maximum(mass, 1e-12), 0
    ).ravel()
    gradient = np.random.default_rng(8).normal(size=(3, 3))
    field(nodes.velocity)[..., :3] = places() @ gradient.T
    grid_to_particles(block, nodes.velocity, nodes.displacement, GRID, 1e-2, soil)
    strain = 0.5 * (gradient + gradient.T)
    strain -= np.eye(3) * np.trace(strain) / 3.0
    rate = np.sqrt(2.0) * np.linalg.norm(strain)
    excess = np.empty(len(bed))
    for n, row in enumerate(bed):
        weight, _ = weights_of(row)
        light = (weight / np.maximum(mass, 1e-12)).sum()
        excess[n] = 1.0 / (light * GRID.dx**3 * soil.bulk_density) - 1.0
    expected = 1.0 / (1.0 + 4.0 * rate * 1e-2 * np.maximum(excess, 0.0))
    np.testing.assert_allclose(block.particles[:, columns.VOLUME_RATIO], expected, rtol=1e-12)
    inner = (np.abs(bed[:, :3] - middle) < 0.02).all(axis=1)
    assert excess[inner].mean() == pytest.approx(0.1, abs=0.04)
    assert (excess < 0).any()  # at the surface, which no pressure is to push away
