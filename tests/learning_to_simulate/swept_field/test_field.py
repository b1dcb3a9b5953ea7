"""Symmetries and exact zeros of a field with random weights; its folder."""

import numpy as np
import pytest

from learning_to_simulate.swept_field import field as field_lib
from learning_to_simulate.tool import blade
from tests.learning_to_simulate.swept_field import small_world as world


def local_rest(field, plane):
    origin = np.array([plane[0, 0, 0], world.SURFACE, 0.0])
    return (world.AXES.points(field.rest) - origin).astype(np.float32)


def test_reflection_across_the_middle_plane():
    plane = world.path()
    field, frames = world.make_field(), world.frames(plane)
    rest = local_rest(field, plane)
    mirror = np.array([1, 1, -1], np.float32)
    here, there = field.displacement(frames, rest), field.displacement(frames, rest * mirror)
    assert np.abs(here[..., 2]).max() > 1e-3
    np.testing.assert_allclose(there, here * mirror, atol=2e-6)


def test_nothing_moves_where_nothing_has_been():
    """Before the soil is touched nothing moves at all; later only what lies near the cut."""
    plane = world.path()
    field, frames = world.make_field(), world.frames(plane)
    rest = local_rest(field, plane)
    moved = np.abs(field.displacement(frames, rest)).max(axis=(0, 3))
    untouched = ~(frames.bins[..., blade.CUT] > 0).any(axis=1)
    assert untouched.any() and not moved[untouched].any()
    assert moved.max() > 0.01
    cut = frames.bins[-1, :, blade.CUT] > 0
    near = np.abs(rest[:, :1] - world.GRID.offsets[cut]).min(axis=1)
    assert not moved[:, near > blade.REACH].any()


def test_leaving_out_particles_changes_nothing():
    plane = world.path()
    field, frames = world.make_field(), world.frames(plane)
    rest = local_rest(field, plane)
    some = field.displacement(frames, rest)
    every = field.network.displacement(
        frames.bins, frames.scalars, np.broadcast_to(rest, (len(plane), *rest.shape))
    ).numpy()
    moving = field.may_move(frames, rest)
    assert 0.05 < moving.mean() < 0.95
    # Products of other sizes round otherwise: 2 um.
    np.testing.assert_allclose(some, every, atol=2e-6)
    assert not every[:, ~moving].any()


def test_no_force_in_the_air_and_none_jumps():
    plane = world.path(601, dt=world.DT / 10)
    field, frames = world.make_field(), world.frames(plane)
    loads = field.loads(frames)
    high = world.path()[:10] + [[0.0, 0.3, 0.0]]
    assert not field.loads(world.frames(high)).any()
    assert np.abs(loads[..., 0]).max() > 10
    # Lifted out of the cut, clear of any heap that it can have made.
    lifted = np.concatenate(
        [plane, plane[-1:] + np.linspace(0, 0.3, 300)[:, None, None] * [0, 1, 0]]
    )
    after = field.loads(world.frames(lifted))[:, len(plane) :]
    assert after[:, 0].any() and not after[:, -60:].any()
    # No jump, even of random weights, but where the velocity itself jumps: in first frames.
    assert np.abs(np.diff(after[:, 1:], axis=1)).max() < 0.25 * np.abs(loads).max()
    assert np.abs(np.diff(loads[:, 1:], axis=1)).max() < 0.25 * np.abs(loads).max()


def test_the_fourth_output_of_the_load_is_the_logarithm_of_a_gain():
    field, frames = world.make_field(), world.frames(world.path())
    loads = field.loads(frames)
    _, bias = field.network.load.layers[-1]
    bias.assign(bias + [0.0, 0.0, 0.0, np.log(2.0)])
    np.testing.assert_allclose(field.loads(frames), 2.0 * loads, rtol=1e-4, atol=1e-3)
    bias.assign(bias + [0.0, 0.0, 0.0, 100.0])
    assert np.isfinite(field.loads(frames)).all()


def test_members_are_those_of_the_ensemble():
    plane = world.path()
    field, frames = world.make_field(), world.frames(plane)
    rest = local_rest(field, plane)[::7]
    whole = field.displacement(frames, rest)
    np.testing.assert_allclose(field.displacement(frames, rest, 1), whole[:1], atol=2e-6)
    np.testing.assert_allclose(field.loads(frames, 2), field.loads(frames)[:2], atol=1e-4)
    assert np.abs(whole[0] - whole[1]).max() > 1e-3


def test_a_model_folder_gives_the_same_field(tmp_path):
    field = world.make_field()
    field.calibration = {'soil': [0.1, 2.0, 0.3], 'force': [1.0, 3.0, 0.1]}
    field_lib.save(str(tmp_path), field, {})
    other = field_lib.load(str(tmp_path))
    plane = world.path()
    frames, rest = world.frames(plane), local_rest(field, plane)
    np.testing.assert_array_equal(
        other.displacement(frames, rest), field.displacement(frames, rest)
    )
    np.testing.assert_allclose(other.rest, field.rest, atol=1e-7)
    assert (other.config, other.axes, other.grid, other.tool, other.calibration) == (
        field.config, field.axes, field.grid, field.tool, field.calibration,
    )  # fmt: skip


def test_damaged_model_folders_are_refused(tmp_path):
    field = world.make_field()
    field_lib.save(str(tmp_path), field, {})
    text = (tmp_path / 'config.json').read_text()
    (tmp_path / 'config.json').write_text(text.replace('"members": 3', '"members": 2'))
    with pytest.raises(ValueError, match='not the weights'):
        field_lib.load(str(tmp_path))
    (tmp_path / 'config.json').write_text(text.replace('"axes"', '"axles"'))
    with pytest.raises(ValueError, match='missing, unknown or wrong'):
        field_lib.load(str(tmp_path))
    field.network.soil.layers[0][0].assign(np.nan * field.network.soil.layers[0][0])
    with pytest.raises(ValueError, match='not finite'):
        field_lib.save(str(tmp_path), field, {})
