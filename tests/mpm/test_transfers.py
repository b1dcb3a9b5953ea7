"""Transfers against a plain numpy twin, and what they must conserve."""

import numpy as np
import pytest

from mpm import columns, experiments, fluidity, packing
from mpm.constitutive import Soil
from mpm.scenes import CORNER, Bin
from mpm.transfers import grid_to_particles, particles_to_grid

BOX = Bin((0.1, 0.1, 0.1), 0.02, (6, 6, 6), 1, 0.1, ())
DT = 1e-4


@pytest.fixture
def block(soil):
    """A block with random velocities, gradients and stresses."""
    particles = packing.lattice(BOX, seed=3)
    rng = np.random.default_rng(4)
    particles[:, columns.V : columns.VOLUME_RATIO] = rng.normal(size=(len(particles), 18))
    particles[:, columns.VOLUME_RATIO] = rng.uniform(0.98, 1.02, len(particles))
    return particles


def scatter(particles, soil, dt=DT):
    grid = packing.make_grid(BOX)
    volume = packing.particle_volume(BOX)
    work = np.full(4 * grid.nodes, np.nan)
    status = np.zeros(3, dtype=np.int64)
    top = particles_to_grid(
        particles,
        work,
        grid.shape,
        grid.origin,
        grid.dx,
        dt,
        volume * soil.bulk_density,
        volume,
        soil.bulk_modulus,
        status,
    )
    assert status[0] == columns.OK
    nx, ny, nz = grid.shape
    nodes = work.reshape(ny, nx, nz, 4)[:top]
    return grid, volume, work, nodes


def spline(distance):
    """The quadratic B-spline of a distance in cells."""
    d = np.abs(distance)
    return np.where(d < 0.5, 0.75 - d**2, np.where(d < 1.5, 0.5 * (1.5 - d) ** 2, 0.0))


def twin(particles, grid, volume, soil: Soil, dt):
    """Mass and momentum of every node, from the definition: all nodes against all particles."""
    nx, ny, nz = grid.shape
    axes = [grid.origin[a] + np.arange(n) * grid.dx for a, n in zip((1, 0, 2), (ny, nx, nz))]
    y, x, z = np.meshgrid(*axes, indexing='ij')
    result = np.zeros((ny, nx, nz, 4))
    mass = volume * soil.bulk_density
    for row in particles:
        offset = np.stack([x - row[0], y - row[1], z - row[2]], axis=-1)
        weight = spline(offset / grid.dx).prod(axis=-1)
        s = row[columns.S : columns.S + 6]
        ratio = row[columns.VOLUME_RATIO]
        pressure = max(soil.bulk_modulus * (1.0 / ratio - 1.0), 0.0)
        stress = np.array([[s[0], s[3], s[5]], [s[3], s[1], s[4]], [s[5], s[4], s[2]]])
        stress -= pressure * np.eye(3)
        gradient = row[columns.C : columns.C + 9].reshape(3, 3)
        affine = mass * gradient - dt * volume * ratio * 4.0 / grid.dx**2 * stress
        momentum = mass * row[columns.V : columns.V + 3] + offset @ affine.T
        result[..., :3] += weight[..., None] * momentum
        result[..., 3] += weight * mass
    return result


def test_scatter_equals_its_definition(block, soil):
    grid, volume, _, nodes = scatter(block, soil)
    expected = twin(block, grid, volume, soil, DT)
    assert not expected[len(nodes) :].any()
    scale = np.abs(expected).max(axis=(0, 1, 2))
    # Sums of some 200 terms in another order: measured 2e-15.
    np.testing.assert_allclose(nodes / scale, expected[: len(nodes)] / scale, atol=1e-13)


def test_mass_and_momentum_are_conserved(block, soil):
    _, volume, _, nodes = scatter(block, soil)
    mass = volume * soil.bulk_density
    assert nodes[..., 3].sum() == pytest.approx(mass * len(block), rel=1e-12)
    momentum = mass * block[:, columns.V : columns.V + 3].sum(axis=0)
    # Stress and gradient carry none; the forces that cancel are a thousand times larger.
    scale = np.abs(nodes[..., :3]).sum()
    np.testing.assert_allclose(nodes[..., :3].sum(axis=(0, 1, 2)), momentum, atol=1e-13 * scale)


def test_gather_of_a_linear_field_is_exact(block, soil):
    """APIC takes up any linear velocity field, and moves the particles with it."""
    grid, _, work, nodes = scatter(block, soil)
    rng = np.random.default_rng(5)
    velocity, gradient = rng.normal(size=3), rng.normal(size=(3, 3))
    nx, ny, nz = grid.shape
    axes = [grid.origin[a] + np.arange(n) * grid.dx for a, n in zip((1, 0, 2), (ny, nx, nz))]
    y, x, z = np.meshgrid(*axes, indexing='ij')
    field = work.reshape(ny, nx, nz, 4)
    field[..., :3] = velocity + np.stack([x, y, z], axis=-1) @ gradient.T
    before = block[:, :3].copy()
    grid_to_particles(block, work, grid.shape, grid.origin, grid.dx, 1e-6, soil, None)
    expected = velocity + before @ gradient.T
    np.testing.assert_allclose(block[:, columns.V : columns.V + 3], expected, atol=1e-13)
    np.testing.assert_allclose(
        block[:, columns.C : columns.C + 9].reshape(-1, 3, 3),
        np.broadcast_to(gradient, (len(block), 3, 3)),
        atol=1e-10,
    )
    np.testing.assert_allclose(block[:, :3], before + 1e-6 * expected, atol=1e-15)


def test_volume_follows_the_divergence(block, soil):
    grid, _, work, _ = scatter(block, soil)
    nx, ny, nz = grid.shape
    field = work.reshape(ny, nx, nz, 4)
    field[..., :3] = 0.0
    field[..., 0] = 0.3 * (grid.origin[0] + np.arange(nx) * grid.dx)[None, :, None]
    before = block[:, columns.VOLUME_RATIO].copy()
    grid_to_particles(block, work, grid.shape, grid.origin, grid.dx, 1e-3, soil, None)
    np.testing.assert_allclose(block[:, columns.VOLUME_RATIO] / before, 1.0003, rtol=1e-12)


def test_coincident_particles_and_one_full_cell(soil):
    particles = packing.lattice(BOX, seed=0)
    particles[:, :3] = CORNER + 0.05
    grid, volume, work, nodes = scatter(particles, soil)
    assert np.isfinite(nodes).all()
    total = volume * soil.bulk_density * len(particles)
    assert nodes[..., 3].sum() == pytest.approx(total, rel=1e-12)


@pytest.mark.parametrize('axis', [0, 1, 2])
@pytest.mark.parametrize('place', [-1.0, 5.0, np.nan, np.inf])
def test_particle_off_the_grid_is_reported(block, soil, axis, place):
    experiment = experiments.Experiment(BOX, BOX, soil)
    experiment.particles[7, axis] = place
    number = int(experiment.particles[7, columns.IDENTITY])
    grid = experiment.grid
    status = np.zeros(3, dtype=np.int64)
    particles_to_grid(
        experiment.particles,
        np.zeros(4 * grid.nodes),
        grid.shape,
        grid.origin,
        grid.dx,
        DT,
        1.0,
        1.0,
        soil.bulk_modulus,
        status,
    )
    assert status[0] == columns.LEFT_GRID and status[1] == number


def test_fluidity_spreads_as_the_laplacian_says(soil):
    """A cosine keeps its shape and decays; the sum is conserved."""
    particles = packing.lattice(BOX, seed=0)
    grid = packing.make_grid(BOX)
    wave = 2 * np.pi / 0.1
    particles[:, columns.FLUIDITY] = 1.0 + 0.1 * np.cos(wave * (particles[:, 0] - CORNER))
    work = np.zeros((grid.nodes, 3))
    strong = soil._replace(nonlocal_amplitude=20.0)
    fluidity.diffuse_fluidity(
        particles, work, grid.shape, grid.shape[1], grid.origin, grid.dx, DT, strong
    )
    nx, ny, nz = grid.shape
    mass, value, change = work.reshape(ny, nx, nz, 3).transpose(3, 0, 1, 2)
    rate = DT * (20.0 * soil.grain_diameter) ** 2 / soil.nonlocal_time
    laplacian = sum(np.roll(value, s, axis) - value for axis in range(3) for s in (1, -1))
    inside = (slice(4, 8),) * 3
    assert (mass[3:9, 3:9, 3:9] > 0.0).all()
    np.testing.assert_allclose(change[inside], rate * laplacian[inside] / grid.dx**2, atol=1e-14)
    # Nothing is lost: what one node gives, its neighbour takes.
    assert abs(change.sum()) < 1e-13
    # And the discrete one is the analytic one within the smoothing of the cells and the jitter.
    shape = (value[inside] - 1.0).mean(axis=(0, 2))
    expected = -rate * wave**2 * shape
    np.testing.assert_allclose(change[inside].mean(axis=(0, 2)), expected, rtol=0.3)
