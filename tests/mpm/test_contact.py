"""Contact node by node, and its momentum balance."""

import numpy as np
import pytest

from mpm import bodies, columns, experiments
from mpm.constitutive import make_soil
from mpm.grid_update import contact
from mpm.scenes import CORNER, Bin

SHAPE = (9, 9, 9)
DX = 0.01
WALLS = (0, 8, 0, 0, 8, 0)


def one_node(velocity, body, pose, motion, mass=2.0, friction=0.3, outset=0.0):
    """Applies contact to the middle node of a small grid; returns velocity after, impulse."""
    grid = np.zeros(4 * 9 * 9 * 9)
    node = 4 * ((4 * 9 + 4) * 9 + 4)
    grid[node : node + 3] = velocity
    grid[node + 3] = mass
    impulse = np.zeros(6)
    contact(
        grid,
        SHAPE,
        9,
        (0.0, 0.0, 0.0),
        DX,
        WALLS,
        body._replace(friction=friction, outset=outset),
        pose,
        motion,
        impulse,
    )
    return grid[node : node + 3].copy(), impulse[:3]


@pytest.fixture
def wheel():
    return bodies.make_wheel(0.1, 0.04)


def below(distance):
    """Pose of the wheel's axle with the middle node straight below it, `distance` outside."""
    return (0.04, 0.04 + 0.05 + distance, 0.0)


def test_node_outside_is_free(wheel):
    """One node too low would let the soil sink by a cell."""
    velocity, impulse = one_node([1.0, 5.0, 0.0], wheel, below(1e-9), (0.0, 0.0, 0.0))
    np.testing.assert_array_equal(velocity, [1.0, 5.0, 0.0])
    assert not impulse.any()


def test_node_deep_inside_obeys_coulomb(wheel):
    # Soil rises at 0.5 m/s into the wheel and slides at 1 m/s along it.
    velocity, impulse = one_node([1.0, 0.5, 0.0], wheel, below(-0.02), (0.0, 0.0, 0.0))
    np.testing.assert_allclose(velocity, [1.0 - 0.3 * 0.5, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(impulse, [2.0 * 0.15, 2.0 * 0.5, 0.0], atol=1e-15)


def test_slow_sliding_sticks(wheel):
    velocity, _ = one_node([0.1, 0.5, 0.05], wheel, below(-0.02), (0.0, 0.0, 0.0))
    np.testing.assert_allclose(velocity, 0.0, atol=1e-15)


def test_soil_that_leaves_is_free(wheel):
    velocity, impulse = one_node([1.0, -0.5, 0.0], wheel, below(-0.02), (0.0, 0.0, 0.0))
    np.testing.assert_array_equal(velocity, [1.0, -0.5, 0.0])
    assert not impulse.any()


def test_spin_drags_soil_along_the_rim(wheel):
    # A positive spin moves the lowest point towards +x.
    spin = 10.0
    velocity, impulse = one_node([0.0, 5.0, 0.0], wheel, below(-0.02), (0.0, 0.0, spin))
    np.testing.assert_allclose(velocity, [spin * 0.03, 0.0, 0.0], atol=1e-12)
    assert impulse[0] < 0.0  # the wheel is pushed forward, to -x


@pytest.mark.parametrize('share', [0.0, 0.25, 0.5, 1.0])
def test_surface_takes_soil_along_gradually(share):
    """Over one cell of depth the soil's share of the body's own normal speed grows to all."""
    blade = bodies.make_blade(0.04)
    # The node lies in front of the blade's face, at a depth of share x cell.
    pose = (0.04 + blade.radius - share * DX, 0.0, 0.0)
    velocity, _ = one_node([0.0, 0.0, 0.0], blade, pose, (-0.1, 0.0, 0.0))
    assert velocity[0] == pytest.approx(-0.1 * share, abs=1e-12)


def test_outset_moves_the_start_of_contact_out():
    blade = bodies.make_blade(0.04)
    pose = (0.04 + blade.radius + 0.004, 0.0, 0.0)  # 0.4 cells ahead of the face
    free, _ = one_node([0.0, 0.0, 0.0], blade, pose, (-0.1, 0.0, 0.0), outset=0.0)
    held, _ = one_node([0.0, 0.0, 0.0], blade, pose, (-0.1, 0.0, 0.0), outset=0.5)
    assert free[0] == 0.0 and held[0] == pytest.approx(-0.01)


@pytest.mark.parametrize('seed', range(20))
def test_impulse_stays_in_the_friction_cone_and_takes_energy(wheel, seed):
    rng = np.random.default_rng(seed)
    before = rng.normal(size=3)
    after, impulse = one_node(before, wheel, below(-0.02), (0.0, 0.0, 0.0), friction=0.5)
    np.testing.assert_allclose(impulse, 2.0 * (before - after), atol=1e-14)
    normal = abs(impulse[1])
    assert np.hypot(impulse[0], impulse[2]) <= 0.5 * normal * (1 + 1e-12)
    assert np.linalg.norm(after) <= np.linalg.norm(before) * (1 + 1e-12)


def test_body_takes_what_the_soil_loses():
    balance = experiments.contact_momentum()
    assert balance['impulse_N_s'] > 1.0
    assert balance['unbalanced'] < 1e-12  # measured 2e-15


def test_torque_is_the_moment_of_the_same_impulses():
    """On a random field: linear and angular part against sums over what the nodes lost."""
    rng = np.random.default_rng(0)
    nodes = np.zeros((9, 9, 9, 4))  # y, x, z
    nodes[..., :3] = rng.normal(size=(9, 9, 9, 3))
    nodes[..., 3] = rng.uniform(0.5, 2.0, (9, 9, 9))
    grid = nodes.reshape(-1).copy()
    blade = bodies.make_blade(0.04, 0.05)
    impulse = np.zeros(6)
    pose = (0.035, 0.025, -0.4)
    contact(grid, SHAPE, 9, (0.0,) * 3, DX, WALLS, blade, pose, (-0.2, 0.1, 3.0), impulse)
    after = grid.reshape(9, 9, 9, 4)
    lost = (nodes[..., :3] - after[..., :3]) * nodes[..., 3:]
    assert (lost != 0.0).any(axis=-1).sum() > 20
    j, i, k = np.meshgrid(*(np.arange(9) * DX,) * 3, indexing='ij')
    arm = np.stack([i, j, k], axis=-1) - [pose[0], pose[1], blade.z_middle]
    np.testing.assert_allclose(impulse[:3], lost.sum(axis=(0, 1, 2)), atol=1e-12)
    np.testing.assert_allclose(impulse[3:], np.cross(arm, lost).sum(axis=(0, 1, 2)), atol=1e-13)


def test_body_takes_the_moment_that_the_soil_loses():
    """A blade tips over in weightless soil: angular momentum about its edge, affine parts too."""
    room = Bin((0.4, 0.1, 0.4), 0.02, (0, 0, 0), 1, 0.5, ())
    block = Bin((0.4, 0.1, 0.4), 0.02, (30, 8, 30), 1, 0.5, ())
    experiment = experiments.Experiment(room, block, make_soil(1.5e6, 0.76), lift=0.15)
    inside = np.abs(experiment.particles[:, [0, 2]] - CORNER - 0.2).max(axis=1) < 0.1
    experiment.particles = experiment.particles[inside]
    experiment.particles[:, columns.IDENTITY] = np.arange(inside.sum())
    edge = np.array([CORNER + 0.3, CORNER + 0.1, CORNER + 0.2])
    path = np.zeros((201, 3))
    path[:, :2], path[:, 2] = edge[:2], 8.0 * experiment.dt * np.arange(201)
    experiment.advance(200, gravity=0.0, body=bodies.make_blade(edge[2]), path=path)
    x = experiment.particles[:, :3] - edge
    v = experiment.particles[:, columns.V : columns.V + 3]
    c = experiment.particles[:, columns.C : columns.C + 9].reshape(-1, 3, 3)
    turn = np.stack(
        [c[:, 2, 1] - c[:, 1, 2], c[:, 0, 2] - c[:, 2, 0], c[:, 1, 0] - c[:, 0, 1]], axis=1
    )
    moment = experiment.mass * (np.cross(x, v) + experiment.grid.dx**2 / 4 * turn).sum(axis=0)
    given = np.linalg.norm(experiment.impulse[3:])
    assert given > 1e-2
    assert np.linalg.norm(moment + experiment.impulse[3:]) < 1e-10 * given
