"""What a driven wheel has done so far, frame by frame: its path first, then the rut it leaves.

Turn, travel and load are given, the height is predicted. So the state has two halves. The *drive*
is a function of what is given: how far the rim has slipped over each place while it bore on it, the
largest load that each place bore, how long ago. From it a network tells force, torque and height.
The *rut* follows from the height: all that the rim has swept. Neither waits for the other over
time: heights of all frames come from one call.

As in `tool_path` all is relative to the first place of the wheel and to the level of the bed, and a
frame costs the same however long the path is.
"""

from typing import NamedTuple

import numpy as np

from learning_to_simulate.methods import swept_features
from learning_to_simulate.methods.swept_features import SweptGrid
from learning_to_simulate.methods.swept_field import tool_path
from learning_to_simulate.methods.swept_field.tool_path import Bed, Frame

# Memories of travel and rim speed, s.
TIME_SCALES = (0.05, 0.2, 0.6)
# Nothing moves until the wheel has gone or slipped by so much, m, or its load has changed by such a
# share; up to there the motion grows from 0.
STIR, STIR_LOAD = 0.001, 0.1
# Soil farther than this from all that the wheel bore on has not moved, m.
REACH = 0.15
# How steeply the zone that has moved rises away from the rut: rise per length.
RISE = 0.5
# A place counts as fully borne on above this share of the pressure at the middle of the contact.
BORNE = 0.2
# Channels of `Frame.bins`; the first two as those of a blade.
CUT, SURFACE, FIRST_CUT, SINCE, SLID, SHEAR, PEAK, INFLUENCE, DISTURBED = range(9)
CHANNELS = 9
# Columns of a pose, and of a size.
PLACE, HEIGHT, TURNED, LOAD = range(4)
RADIUS, WIDTH, GRAVITY, FRICTION = range(4)
SCALARS = (
    'tip', 'rolled', 'speed', 'rim',
    *(f'{name}_{i}' for i in range(len(TIME_SCALES)) for name in ('speed', 'rim')),
    'travelled', 'slipped', 'foremost', 'rearmost', 'load', 'frame_load', 'peak_load', 'first_load',
    'radius', 'half_width', 'gravity', 'friction', 'sunk', 'contact', 'end', 'stirred',
    'height', 'area',
)  # fmt: skip
# Those that hang on the predicted height; they are not asked for by the force.
_N_DRIVE = len(SCALARS) - 2


class DriveState(NamedTuple):
    """What is given of B wheels so far.

    Attributes:
      size: float64 [B, 4] radius and width (m), gravity (m/s2), tan of the friction angle.
      first: float64 [B, 4] first pose: u, height (m), angle turned (rad), load (N).
      sunk: float64 [B] how deep the rim stood in the bed at first, m.
      pose: float64 [B, 4], the height of no meaning.
      velocity: float64 [B, 2] of travel and of the rim, m/s.
      memory: float64 [B, K, 2] the same, faded with each of the `TIME_SCALES`.
      frame_load: float64 [B] mean load of the last frame, N.
      peak_load: float64 [B] N.
      reach: float64 [B, 2] rearmost and foremost u, m.
      way: float64 [B, 3] travelled, slipped and loaded in all, whatever the sign; m, m, and shares
        of the first load.
      last: float64 [B, n] distance travelled when a bin was last borne on, m.
      slid, shear: float64 [B, n] slip while a bin bore the rim, without and with sign, m.
      peak: float64 [B, n] largest load that a bin bore, N.
    """

    size: np.ndarray
    first: np.ndarray
    sunk: np.ndarray
    pose: np.ndarray
    velocity: np.ndarray
    memory: np.ndarray
    frame_load: np.ndarray
    peak_load: np.ndarray
    reach: np.ndarray
    way: np.ndarray
    last: np.ndarray
    slid: np.ndarray
    shear: np.ndarray
    peak: np.ndarray

    @property
    def contact(self) -> np.ndarray:
        """[B] half the chord in which the rim first cut the surface, m."""
        sunk = np.clip(self.sunk, 0.002, self.size[:, RADIUS])
        return np.sqrt(sunk * (2 * self.size[:, RADIUS] - sunk))


class Rut(NamedTuple):
    """What B wheels have swept.

    Attributes:
      surface: float64 [B, n] of the bed before the wheel was set down, m.
      first, profile: float64 [B, n] lowest height of surface and rim, at first and so far, m.
      position: float64 [B, 2] u and height of the axle, m.
    """

    surface: np.ndarray
    first: np.ndarray
    profile: np.ndarray
    position: np.ndarray


def start(grid: SweptGrid, bed: Bed, size, pose, velocity=None) -> tuple[DriveState, Rut]:
    """The state before any motion.

    Args:
      grid: bins along the way.
      bed: of the wheels.
      size: [B, 4], see `DriveState`.
      pose: [B, 4] likewise; the first height is known.
      velocity: [B, 2] of travel and rim, which they have had for long, m/s; None: at rest.

    Raises:
      ValueError: shapes that do not fit, or values that are not finite.
    """
    size, pose = _checked(size, 'size', None), _checked(pose, 'pose', None)
    velocity = np.zeros((len(pose), 2)) if velocity is None else np.asarray(velocity, np.float64)
    memory = np.repeat(velocity[:, None], len(TIME_SCALES), axis=1)
    sunk = bed.level - (pose[:, HEIGHT] - size[:, RADIUS])
    none = np.zeros((len(pose), len(grid.offsets)))
    drive = DriveState(
        size, pose, sunk, pose, velocity, memory, pose[:, LOAD], pose[:, LOAD],
        np.repeat(pose[:, :1], 2, axis=1), np.zeros((len(pose), 3)),
        none - grid.forget, none, none, none,
    )  # fmt: skip
    borne = _bearing(grid, drive, pose[:, PLACE])
    drive = drive._replace(
        last=np.where(borne > 0, 0.0, drive.last), peak=_share(borne) * pose[:, LOAD:]
    )
    # Before the wheel was set down the bed was level with what lies beside the contact.
    surface = bed.surface.copy()
    for row, contact, radius in zip(surface, drive.contact, size[:, RADIUS], strict=True):
        near = np.abs(grid.offsets) < min(contact + 2 * grid.spacing, radius)
        row[near] = np.interp(grid.offsets[near], grid.offsets[~near], row[~near])
    rim = _rim(grid, drive, pose[:, :2], pose[:, :2])
    profile = np.minimum(surface, rim)
    return drive, Rut(surface, profile, profile, pose[:, :2])


def drive_on(grid: SweptGrid, state: DriveState, pose, dt: float) -> DriveState:
    """The drives one frame later.

    Args:
      grid: of `start`.
      state: before; it is not changed.
      pose: [B, 4]; the height is ignored.
      dt: duration, s.

    Raises:
      ValueError: a duration that is not positive; poses that are not finite or leave the bins.
    """
    if not 0 < dt < np.inf:
        raise ValueError(f'a frame must last longer than 0 s, got {dt}: time does not go back')
    pose = _checked(pose, 'pose', len(state.pose))
    radius = state.size[:, RADIUS]
    offset = pose[:, PLACE] - state.first[:, PLACE]
    low, high = grid.offsets[[0, -1]]
    if (outside := (offset - radius < low) | (offset + radius > high)).any():
        wheel = int(np.argmax(outside))
        raise ValueError(
            f'wheel {wheel} is {offset[wheel]:.3g} m from its first place; with its radius of '
            f'{radius[wheel]:.3g} m the bins from {low:.3g} to {high:.3g} m do not hold it'
        )
    change = pose - state.pose
    step = np.stack([change[:, PLACE], radius * change[:, TURNED]], axis=1)
    velocity = step / dt
    fade = np.exp(-dt / np.array(TIME_SCALES))[:, None]
    slip = (step[:, 1] - step[:, 0])[:, None]
    # What a place bears in a frame is the mean of that at both ends.
    before, after = (_bearing(grid, state, p[:, PLACE]) for p in (state.pose, pose))
    borne = (before + after) / 2
    loaded = np.abs(change[:, LOAD]) / np.maximum(state.first[:, LOAD], 1e-9)
    way = state.way + np.stack([np.abs(step[:, 0]), np.abs(slip[:, 0]), loaded], axis=1)
    return state._replace(
        pose=pose,
        velocity=velocity,
        memory=fade * state.memory + (1 - fade) * velocity[:, None],
        frame_load=(pose[:, LOAD] + state.pose[:, LOAD]) / 2,
        peak_load=np.maximum(state.peak_load, pose[:, LOAD]),
        reach=np.stack(
            [np.minimum(state.reach[:, 0], pose[:, PLACE]),
             np.maximum(state.reach[:, 1], pose[:, PLACE])], axis=1,
        ),
        way=way,
        last=np.where(after > 0, way[:, :1], state.last),
        slid=state.slid + borne * np.abs(slip),
        shear=state.shear + borne * slip,
        peak=np.maximum(state.peak, _share(after) * pose[:, LOAD :]),
    )  # fmt: skip


def sink(grid: SweptGrid, drive: DriveState, rut: Rut, height) -> Rut:
    """The ruts once the wheels of a drive stand at heights [B], m."""
    position = np.stack([drive.pose[:, PLACE], height], axis=1)
    rim = _rim(grid, drive, rut.position, position)
    return rut._replace(profile=np.minimum(rut.profile, rim), position=position)


def frame(grid: SweptGrid, bed: Bed, drive: DriveState, rut: Rut | None = None) -> Frame:
    """What the networks see of a state; without a rut, what the force and the height see: the rest
    is 0."""
    first = drive.first[:, PLACE]
    bins = np.zeros((*drive.slid.shape, CHANNELS), np.float32)
    scalars = np.zeros((len(first), len(SCALARS)), np.float32)
    bins[..., SINCE] = np.minimum(drive.way[:, :1] - drive.last, grid.forget)
    bins[..., SLID], bins[..., SHEAR], bins[..., PEAK] = drive.slid, drive.shear, drive.peak
    radius = drive.size[:, RADIUS]
    stirred = (drive.way / [STIR, STIR, STIR_LOAD]).sum(axis=1)
    columns = [
        drive.pose[:, PLACE] - first,
        radius * (drive.pose[:, TURNED] - drive.first[:, TURNED]),
        *drive.velocity.T, *drive.memory.reshape(len(first), -1).T,
        drive.way[:, 0], drive.way[:, 1], drive.reach[:, 1] - first, drive.reach[:, 0] - first,
        drive.pose[:, LOAD], drive.frame_load, drive.peak_load, drive.first[:, LOAD],
        radius, drive.size[:, WIDTH] / 2, drive.size[:, GRAVITY], drive.size[:, FRICTION],
        drive.sunk, drive.contact, bed.end - first, np.clip(stirred, 0.0, 1.0),
    ]  # fmt: skip
    scalars[:, :_N_DRIVE] = np.stack(columns, axis=1)
    return Frame(bins, scalars) if rut is None else with_rut(grid, bed, Frame(bins, scalars), rut)


def with_rut(grid: SweptGrid, bed: Bed, known: Frame, rut: Rut) -> Frame:
    """A frame of the drive with what the rut adds to it."""
    bins, scalars = known.bins.copy(), known.scalars.copy()
    cut = rut.surface - rut.profile
    bins[..., CUT] = cut
    bins[..., SURFACE] = rut.surface - bed.level[:, None]
    bins[..., FIRST_CUT] = rut.surface - rut.first
    borne = np.minimum(bins[..., PEAK] / np.maximum(scalars[:, _S['first_load']], 1e-9)[:, None], 1)
    touched = np.maximum(borne, np.minimum(cut / tool_path.TOUCH, 1.0))
    spread = tool_path.cone(touched, grid.spacing / REACH)
    stirred = scalars[:, _S['stirred'], None]
    bins[..., INFLUENCE] = np.clip(3.0 * spread, 0.0, 1.0) * stirred
    bins[..., DISTURBED] = tool_path.cone(cut, RISE * grid.spacing)
    scalars[:, _S['height']] = rut.position[:, 1] - bed.level
    scalars[:, _S['area']] = grid.spacing * (rut.first - rut.profile).sum(axis=1)
    return Frame(bins, scalars)


_S = {name: i for i, name in enumerate(SCALARS)}


def _bearing(grid, state, place):
    """[B, n] in [0, 1]: how much of the pressure in the middle of the contact a bin bears."""
    bins = state.first[:, PLACE, None] + grid.offsets
    return np.maximum(1.0 - ((bins - place[:, None]) / state.contact[:, None]) ** 2, 0.0)


def _share(borne):
    return np.minimum(borne / BORNE, 1.0)


def _rim(grid, state, before, after):
    bins = state.first[:, PLACE, None] + grid.offsets
    return swept_features.underside(bins, before, after, state.size[:, :1])


def _checked(values, name, count):
    values = np.asarray(values, np.float64)
    if values.ndim != 2 or values.shape[1] != 4 or count not in (None, len(values)):
        raise ValueError(f'{name} has shape {values.shape}, [{count or "B"}, 4] was expected')
    if not np.isfinite(values).all():
        raise ValueError(
            f'{name} of a wheel is not finite: {values[~np.isfinite(values).all(axis=1)][0]}'
        )
    return values
