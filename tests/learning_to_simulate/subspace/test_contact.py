"""Where a body feels no soil: against surfaces that are known."""

from types import SimpleNamespace

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate.normalization import Statistics
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import contact
from learning_to_simulate.subspace.contact import RAMP, Contact
from tests.learning_to_simulate import models

H = 6
X = np.linspace(0.0, 1.0, 65)
SCENE = SimpleNamespace(
    rigid_motion=RigidMotion.PRESCRIBED, bodies=(), has_force=True, up_axis=1, n_modes=1
)


def ground():
    """A bed 0.2 m high whose one mode raises a ridge along the middle half of it."""
    x, z = (a.ravel() for a in np.meshgrid(X, np.linspace(0.0, 0.4, 9), indexing='ij'))
    mean = np.stack([x, np.full_like(x, 0.2), z], axis=1)
    ridge = np.where((x > 0.25) & (x < 0.75), 1.0, 0.0)[:, None]
    return SimpleNamespace(components=ridge, mean=mean, n_soil=len(x), initial=mean)


def runs(lowest, touch=0.012):
    """A body over the ridge, in frames that come down to `lowest` above it; it feels what it is
    nearer to than `touch`."""
    frames = np.arange(200)
    ridge = 0.05 * np.sin(frames / 20.0) ** 2
    above = lowest + 0.06 * np.abs(np.cos(frames / 9.0))
    centre = np.stack([0.6 - 0.001 * frames, 0.2 + ridge + above, 0.0 * frames], axis=1)
    body = centre[:, None] + np.array([[0, 0, 0.1], [0, 0, 0.3], [0, 0.1, 0.2]])
    modes = np.stack([0 * ridge, ridge, 0 * ridge], axis=1)[:, None]
    force = np.where(above < touch, 100.0, 0.0)[:, None] * [1.0, 0.0, 0.0]
    position = np.concatenate([body, modes], axis=1)[None]
    return SimpleNamespace(position=position, n_rigid=3, force=force[None]), above


def test_the_surface_and_the_clearance_are_found():
    group, above = runs(0.0)
    origin = group.position[0, :, 3:].mean(axis=0)
    found = contact.fit([group], ground(), origin, SCENE)
    assert found.axis == 0
    offsets = group.position[0, :, 3:] - origin
    body = group.position[0, :, :3]
    clearance = found.clearance(body, offsets)
    # The ridge is as flat as the ground: the soil below the body is the nearest, but for a place
    # that may be half a slab beside it. Ridge regression keeps all but 1e-4 of the height.
    beside = contact.SLOPE * 0.5 / contact.PLACES + 1e-4
    np.testing.assert_allclose(clearance, above, atol=beside)
    assert 0.011 < found.clear < 0.012 + beside
    share = found.share(tf.constant(body, tf.float32), tf.constant(offsets, tf.float32)).numpy()
    assert (share[above > 0.012 + beside + RAMP] == 0).all()
    assert (share[above < 0.011 - beside] == 1).all()


def test_soil_beside_the_body_counts_as_lower_with_its_distance():
    reader = Contact(0, 1, 0.0, np.float32([0.5]), np.float32([0.3]), np.zeros((1, 3, 1), 'f4'))
    body = np.array([[[0.5, 0.4, 0.0]], [[0.7, 0.4, 0.0]], [[0.7, 0.25, 0.0]]])
    np.testing.assert_allclose(reader.clearance(body, np.zeros((3, 1, 3))), [0.1, 0.2, 0.05], 1e-5)


@pytest.mark.parametrize(
    'group, scene',
    [
        (runs(0.0, touch=1.0)[0], SCENE),
        (runs(0.0, touch=0.0)[0], SCENE),
        (runs(0.0)[0], SimpleNamespace(**vars(SCENE) | {'has_force': False})),
        (runs(0.0)[0], SimpleNamespace(**vars(SCENE) | {'rigid_motion': RigidMotion.DRIVEN})),
        (runs(0.0)[0], SimpleNamespace(**vars(SCENE) | {'bodies': (('a', 1), ('b', 2))})),
    ],
    ids=['always in contact', 'never', 'no force', 'driven', 'two bodies'],
)
def test_there_is_nothing_to_find(group, scene):
    assert contact.fit([group], ground(), group.position[0, :, 3:].mean(axis=0), scene) is None


def test_damaged_statistics_are_refused(tmp_path):
    model, _, _ = models.make(tmp_path, contact=True)
    s = model.simulator
    values = s.statistics.to_json()
    assert (Statistics.from_json(values).surface == s.statistics.surface).all()
    for name, wrong, message in (
        ('surface', None, 'presence of statistics.contact'),
        ('surface', [[0.0, 0.1]], 'statistics.surface of shape'),
        ('surface', [], 'places of statistics.surface is 0'),
        ('contact', [1.0, 0.02], 'axis of statistics.contact is 1'),
        ('contact', [0.0, float('nan')], "statistics.contact is 'not finite'"),
    ):
        damaged = Statistics.from_json(values | {name: wrong})
        with pytest.raises(ValueError, match=message):
            damaged.check(s.scene)
