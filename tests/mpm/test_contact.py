"""Contact at the particles, eqs. (5) and (6), and its balance of moment."""

import math

import numpy as np
import pytest

from mpm import bodies, columns
from mpm.contact import ContactLaw, contact, make_contact
from mpm.grid import make_grid
from mpm.scenes import CORNER, Bin
from mpm.solver import make_block, make_nodes
from mpm.transfers import particles_to_grid
from tests.mpm.small import SOIL

ROOM = Bin((0.12, 0.1, 0.12), 0.01, 0.02, (0, 0, 0), 1, 0.12, ())
GRID = make_grid(ROOM)
MIDDLE = np.full(3, CORNER + 0.06)
LAW = ContactLaw(radius=0.002, stiffness=1e4)
DT = 1e-4
WHEEL = bodies.make_wheel(0.1)
STILL = (0.0, 0.0, 0.0)
NO_RATES = (0.0, 0.0, 0.0, 0.0)


def touch(position, velocity, body, pose, motion=NO_RATES, grip=STILL, dt=DT, moved=STILL):
    """Contact of one particle; returns its grip, the force on the soil, the load on the body.

    Args:
        moved: how far its nodes have gone since the exchange, m.
    """
    row = np.zeros((1, columns.COLUMNS))
    row[0, :3], row[0, columns.VOLUME_RATIO] = position, 1.0
    row[0, columns.GRIP : columns.GRIP + 3] = grip
    block, nodes, status = make_block(row), make_nodes(GRID), np.zeros(2, dtype=np.int64)
    particles_to_grid(block, nodes.velocity, GRID, 0.0, 1e-6, SOIL, status)
    assert not status.any()
    touched = nodes.velocity.reshape(-1, 4)[:, 3] > 0.0
    nodes.velocity.reshape(-1, 4)[touched, :3] = velocity
    nodes.displacement.reshape(-1, 4)[touched, :3] = moved
    load, near = np.full(6, np.nan), np.zeros(1, dtype=np.int64)
    contact(block, nodes, GRID, near, body, LAW, pose, motion, dt, load)
    grip = block.particles[0, columns.GRIP : columns.GRIP + 3].copy()
    return grip, nodes.force.reshape(-1, 4)[:, :3].sum(axis=0), load


def below(depth):
    """Pose of the wheel's axle, straight above the middle particle, which touches by `depth`."""
    return (MIDDLE[0], MIDDLE[1] + WHEEL.radius + LAW.radius - depth, 0.0, MIDDLE[2])


def test_particle_outside_its_radius_is_free_and_lets_go():
    grip, force, load = touch(MIDDLE, [0, 5.0, 0], WHEEL, below(-1e-9), grip=(1.0, 2.0, 3.0))
    assert not grip.any() and not force.any() and not load.any()
    # The nodes' displacement counts: what was outside at the exchange is inside now.
    _, force, _ = touch(MIDDLE, STILL, WHEEL, below(-1e-3), moved=(0.0, 3e-3, 0.0))
    np.testing.assert_allclose(force, [0.0, -LAW.stiffness * 2e-3, 0.0], rtol=1e-9, atol=1e-12)


def test_grip_grows_with_the_way_until_coulombs_limit():
    """Below the limit a spring of the way, k g; beyond it mu N against the motion."""
    depth, friction = 1e-3, WHEEL.friction
    limit = friction * depth
    grip = np.zeros(3)
    for n in range(1, 11):
        grip, force, _ = touch(MIDDLE, [0.6, 0.0, 0.8], WHEEL, below(depth), grip=grip)
        way = min(n * DT, limit)
        np.testing.assert_allclose(grip, way * np.array([0.6, 0.0, 0.8]), atol=1e-12)
        np.testing.assert_allclose(force[[0, 2]], -LAW.stiffness * grip[[0, 2]], atol=1e-9)
    assert np.linalg.norm(grip) == pytest.approx(limit)
    # On the way back the spring turns round at once: a history, not a function of the velocity.
    grip, force, _ = touch(MIDDLE, [-0.6, 0.0, -0.8], WHEEL, below(depth), grip=grip)
    assert np.linalg.norm(grip) == pytest.approx(limit - DT) and force[0] < 0.0


def test_body_that_moves_with_the_soil_drags_nothing():
    motion = (-0.3, 0.2, 1.5, 0.4)
    pose = below(1e-3)
    arm = MIDDLE[:2] + [0.0, LAW.radius - 1e-3] - pose[:2]
    velocity = [motion[0] - motion[2] * arm[1], motion[1] + motion[2] * arm[0], 0.4]
    grip, _, _ = touch(MIDDLE, velocity, WHEEL, pose, motion)
    np.testing.assert_allclose(grip, 0.0, atol=1e-18)


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('friction', [0.0, 0.5])
def test_force_lies_in_the_cone_and_its_moment_balances(seed, friction):
    """On a leaning blade, anywhere near its surface, against sums over what the soil gets."""
    rng = np.random.default_rng(seed)
    blade = bodies.make_blade(0.06)._replace(friction=friction)
    lean = rng.uniform(-0.5, 0.5)
    pose = (MIDDLE[0], MIDDLE[1] - 0.02, lean, MIDDLE[2])
    # A point of the front face, then as deep or as far as contact is.
    along, gap = rng.uniform(0.0, 0.05), rng.uniform(-0.004, 0.0019)
    ahead = -(blade.radius + gap)
    position = [
        pose[0] + ahead * math.cos(lean) - along * math.sin(lean),
        pose[1] + ahead * math.sin(lean) + along * math.cos(lean),
        MIDDLE[2] + rng.uniform(-0.02, 0.02),
    ]
    grip, force, load = touch(
        position, rng.normal(size=3), blade, pose, tuple(rng.normal(size=4)), rng.normal(size=3)
    )
    outward = np.array([-math.cos(lean), -math.sin(lean), 0.0])
    normal = force @ outward
    assert normal == pytest.approx(LAW.stiffness * (LAW.radius - gap))
    sliding = force - normal * outward
    assert np.linalg.norm(sliding) == pytest.approx(friction * normal, abs=1e-9)
    np.testing.assert_allclose(sliding, -LAW.stiffness * grip, atol=1e-9)
    np.testing.assert_allclose(load[:3], -force, atol=1e-9)
    # The soil gets the force at the particle, the body at the foot of the perpendicular.
    arm = np.array(position) - [*pose[:2], pose[3]]
    unbalanced = load[3:] + np.cross(arm, force)
    expected = np.cross(gap * outward, force)
    np.testing.assert_allclose(unbalanced, expected, atol=1e-12 * LAW.stiffness)
    assert np.linalg.norm(unbalanced) <= friction * normal * abs(gap) + 1e-9


def test_stiffness_and_radius_follow_from_the_soil():
    # Particles 2 mm apart in the plane and 6 mm across.
    law = make_contact(SOIL, 24e-9, 2e-3)
    assert law.radius == pytest.approx(1e-3)  # half of 2 mm
    modulus = 1.5e6 * 0.7 / (1.3 * 0.4)  # E (1 - nu) / ((1 + nu) (1 - 2 nu))
    assert law.stiffness == pytest.approx(modulus * 12e-6 / (4 * 2e-3))
