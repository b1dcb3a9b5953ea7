"""What a driven wheel has done so far, frame by frame: its path first, then the rut it leaves.

Turn, travel and load are given, the height is predicted. So the state has two halves. The *drive*
is a function of what is given: how far the rim has slipped over each place while it bore on it, the
largest load that each place bore, how long ago. From it a network tells force, torque and height.
The *rut* follows from the height: all that the rim has swept. Neither waits for the other over
time: heights of all frames come from one call.

As in `tool_path` all is relative to the first place of the wheel and to the level of the bed, and a
frame costs the same however long the path is. `xp` is numpy, or `tensors` in a TensorFlow graph,
where nothing is refused.
"""

from typing import NamedTuple

import numpy as np

from learning_to_simulate.methods import swept_features
from learning_to_simulate.methods.swept_features import Finer, SweptGrid
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
    'radius', 'half_width', 'gravity', 'friction', 'sunk', 'contact', 'end', 'room',
    'stirred', 'height', 'area',
)  # fmt: skip
# Those that hang on the predicted height; they are not asked for by the force.
_N_DRIVE = len(SCALARS) - 2


class DriveState(NamedTuple):
    """What is given of B wheels so far.

    Attributes:
      size: float64 [B, 4] radius and width (m), gravity (m/s2), tan of the friction angle.
      first: float64 [B, 4] first pose: u, height (m), angle turned (rad), load (N).
      sunk: float64 [B] how deep the rim stood in the bed at first, m.
      contact: float64 [B] half the chord in which it cut the surface then, m.
      pose: float64 [B, 4], the height of no meaning.
      velocity: float64 [B, 2] of travel and of the rim, m/s.
      memory: float64 [B, K, 2] the same, faded with each of the `TIME_SCALES`.
      frame_load: float64 [B] mean load of the last frame, N.
      peak_load: float64 [B] N.
      reach: float64 [B, 2] rearmost and foremost u, m.
      way: float64 [B, 3] travelled, slipped and loaded in all, whatever the sign; m, m, and shares
        of the first load.
      since: float64 [B, n] distance travelled since a bin was last borne on, m; at first
        `grid.forget` where none was.
      slid, shear: float64 [B, n] slip while a bin bore the rim, without and with sign, m.
      peak: float64 [B, n] largest load that a bin bore, N.
    """

    size: np.ndarray
    first: np.ndarray
    sunk: np.ndarray
    contact: np.ndarray
    pose: np.ndarray
    velocity: np.ndarray
    memory: np.ndarray
    frame_load: np.ndarray
    peak_load: np.ndarray
    reach: np.ndarray
    way: np.ndarray
    since: np.ndarray
    slid: np.ndarray
    shear: np.ndarray
    peak: np.ndarray


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


def friction_of(angle_deg, xp=np):
    """Tan of a friction angle (degrees), as a size has it."""
    return xp.tan(np.pi / 180 * angle_deg)


def start(
    grid: SweptGrid, bed: Bed, size, pose, velocity=None, xp=np, edge=None
) -> tuple[DriveState, Rut]:
    """The state before any motion.

    Args:
      grid: bins along the way.
      bed: of the wheels.
      size: [B, 4], see `DriveState`.
      pose: [B, 4] likewise; the first height is known.
      velocity: [B, 2] of travel and rim, which they have had for long, m/s; None: at rest.
      xp: numpy or `tensors`.
      edge: [B, n] as of `swept_features.Finer`, at first.

    Raises:
      ValueError: shapes that do not fit, or values that are not finite.
    """
    if xp is np:
        size, pose = _checked(size, 'size', None), _checked(pose, 'pose', None)
    velocity = xp.zeros_like(pose[:, :2]) if velocity is None else xp.asarray(velocity, np.float64)
    radius, place, load = size[:, RADIUS], pose[:, PLACE], pose[:, LOAD]
    sunk = bed.level - (pose[:, HEIGHT] - radius)
    depth = xp.maximum(sunk, 0.002)
    chord = xp.sqrt(xp.maximum(depth * (2 * radius - depth), 0.0))
    contact = xp.where(depth < radius, chord, radius)  # no root is the radius to the last digit
    if edge is None:
        edge = swept_features.within(_bins(grid, place), place[:, None], radius[:, None], xp)
    on_contact = _on_contact(edge, radius, contact)
    borne = _bearing(on_contact, contact, xp)
    none, still = xp.zeros_like(bed.surface), xp.zeros_like(place)
    drive = DriveState(
        size, pose, sunk, contact, pose, velocity, xp.stack([velocity] * len(TIME_SCALES), axis=1),
        load, load, xp.stack([place] * 2, axis=1), xp.stack([still] * 3, axis=1),
        xp.where(borne > 0, none, xp.full_like(none, grid.forget)), none, none,
        _share(borne, xp) * load[:, None],
    )  # fmt: skip
    # Before the wheel was set down the bed was level with what lies beside the contact.
    near = (edge > 0) & (on_contact + 2 * grid.spacing > 0)
    surface = _level(grid, bed.surface, near, xp)
    profile = xp.minimum(surface, _rim(grid, drive, pose[:, :2], pose[:, :2], xp, (edge, edge)))
    return drive, Rut(surface, profile, profile, pose[:, :2])


def leaves_bins(grid: SweptGrid, state: DriveState, pose):
    """Bool [B]: wheels whose rim reaches beyond the bins at poses [B, 4]."""
    offset, radius = pose[:, PLACE] - state.first[:, PLACE], state.size[:, RADIUS]
    low, high = grid.offsets[[0, -1]]
    return (offset - radius < low) | (offset + radius > high)


def drive_on(grid: SweptGrid, state: DriveState, pose, dt, xp=np, finer=None) -> DriveState:
    """The drives one frame later.

    Args:
      grid: of `start`.
      state: before; it is not changed.
      pose: [B, 4]; the height is ignored.
      dt: duration, s.
      xp: numpy or `tensors`.
      finer: `swept_features.Finer`, where places are float32; its `step` is of u (m) and of the
        angle turned (rad).

    Raises:
      ValueError: a duration that is not positive; poses that are not finite or leave the bins.
    """
    if xp is np:
        if not 0 < dt < np.inf:
            raise ValueError(f'a frame must last longer than 0 s, got {dt}: time does not go back')
        pose = _checked(pose, 'pose', len(state.pose))
        _refuse_outside(grid, state, pose)
    gone, edge = _differences(grid, state, pose, xp) if finer is None else finer
    radius, contact = state.size[:, RADIUS], state.contact
    step = xp.stack([gone[:, 0], radius * gone[:, 1]], axis=1)
    velocity = step / dt
    fade = xp.exp(-dt / np.array(TIME_SCALES))[:, None]
    slip = (step[:, 1] - step[:, 0])[:, None]
    # What a place bears in a frame is the mean of that at both ends.
    before, after = (_bearing(_on_contact(x, radius, contact), contact, xp) for x in edge)
    borne = (before + after) / 2
    place, load = pose[:, PLACE], pose[:, LOAD]
    loaded = xp.abs(load - state.pose[:, LOAD]) / xp.maximum(state.first[:, LOAD], 1e-9)
    far = xp.abs(step[:, :1])
    return state._replace(
        pose=pose,
        velocity=velocity,
        memory=fade * state.memory + (1 - fade) * velocity[:, None],
        frame_load=(load + state.pose[:, LOAD]) / 2,
        peak_load=xp.maximum(state.peak_load, load),
        reach=xp.stack(
            [xp.minimum(state.reach[:, 0], place), xp.maximum(state.reach[:, 1], place)], axis=1
        ),
        way=state.way + xp.concatenate([far, xp.abs(slip), loaded[:, None]], axis=1),
        since=xp.where(after > 0, xp.zeros_like(after), state.since + far),
        slid=state.slid + borne * xp.abs(slip),
        shear=state.shear + borne * slip,
        peak=xp.maximum(state.peak, _share(after, xp) * load[:, None]),
    )


def sink(grid: SweptGrid, drive: DriveState, rut: Rut, height, xp=np, finer=None) -> Rut:
    """The ruts once the wheels of a drive stand at heights [B], m; `finer` as of `drive_on`."""
    position = xp.stack([drive.pose[:, PLACE], height], axis=1)
    edge = None if finer is None else finer.edge
    rim = _rim(grid, drive, rut.position, position, xp, edge)
    return rut._replace(profile=xp.minimum(rut.profile, rim), position=position)


def frame(grid: SweptGrid, bed: Bed, drive: DriveState, rut: Rut | None = None, xp=np) -> Frame:
    """What the networks see of a state; without a rut, what the force and the height see: the rest
    is 0. Tensors keep the type of the state."""
    first, radius = drive.first[:, PLACE], drive.size[:, RADIUS]
    none, zero = xp.zeros_like(drive.slid), xp.zeros_like(first)
    bins = xp.stack(
        [none] * 3
        + [xp.minimum(drive.since, grid.forget), drive.slid, drive.shear, drive.peak]
        + [none] * 2,
        axis=-1,
    )
    stirred = xp.sum(drive.way / np.array([STIR, STIR, STIR_LOAD]), axis=1)
    gone = [
        drive.pose[:, PLACE] - first,
        radius * (drive.pose[:, TURNED] - drive.first[:, TURNED]),
    ]
    rest = [
        drive.way[:, 0], drive.way[:, 1], drive.reach[:, 1] - first, drive.reach[:, 0] - first,
        drive.pose[:, LOAD], drive.frame_load, drive.peak_load, drive.first[:, LOAD],
        radius, drive.size[:, WIDTH] / 2, drive.size[:, GRAVITY], drive.size[:, FRICTION],
        drive.sunk, drive.contact, bed.end - first, bed.end - drive.reach[:, 1],
        xp.clip(stirred, 0.0, 1.0), zero, zero,
    ]  # fmt: skip
    scalars = xp.concatenate(
        [
            xp.stack(gone, axis=1),
            drive.velocity,
            *(drive.memory[:, i] for i in range(len(TIME_SCALES))),
            xp.stack(rest, axis=1),
        ],
        axis=1,
    )
    known = Frame(xp.asarray(bins, np.float32), xp.asarray(scalars, np.float32))
    return known if rut is None else with_rut(grid, bed, known, rut, xp)


def with_rut(grid: SweptGrid, bed: Bed, known: Frame, rut: Rut, xp=np) -> Frame:
    """A frame of the drive with what the rut adds to it."""
    cut = rut.surface - rut.profile
    first_load, stirred = (known.scalars[:, _S[n], None] for n in ('first_load', 'stirred'))
    borne = xp.minimum(known.bins[..., PEAK] / xp.maximum(first_load, 1e-9), 1.0)
    touched = xp.maximum(borne, xp.minimum(cut / tool_path.TOUCH, 1.0))
    spread = tool_path.cone(touched, grid.spacing / REACH, xp)
    seen = [cut, rut.surface - bed.level[:, None], rut.surface - rut.first]
    reached = [
        xp.clip(3.0 * spread, 0.0, 1.0) * stirred,
        tool_path.cone(cut, RISE * grid.spacing, xp),
    ]
    area = grid.spacing * xp.sum(rut.first - rut.profile, axis=1)
    of_rut = xp.stack([rut.position[:, 1] - bed.level, area], axis=1)
    before, after = (xp.asarray(xp.stack(part, axis=-1), np.float32) for part in (seen, reached))
    return Frame(
        xp.concatenate([before, known.bins[..., SINCE:INFLUENCE], after], axis=-1),
        xp.concatenate([known.scalars[:, :_N_DRIVE], xp.asarray(of_rut, np.float32)], axis=1),
    )


_S = {name: i for i, name in enumerate(SCALARS)}


def _bins(grid, first):
    """[B, n] places of the bins about first places [B], m."""
    return first[:, None] + grid.offsets


def _differences(grid, drive, pose, xp):
    """`Finer` of what the poses themselves say."""
    bins, gone = _bins(grid, drive.first[:, PLACE]), pose - drive.pose
    edge = tuple(
        swept_features.within(bins, end[:, PLACE, None], drive.size[:, :1], xp)
        for end in (drive.pose, pose)
    )
    return Finer(xp.stack([gone[:, PLACE], gone[:, TURNED]], axis=1), edge)


def _on_contact(edge, radius, contact):
    """How far bins lie within the contact, from how far they lie within the rim, m."""
    return edge - (radius - contact)[:, None]


def _bearing(on_contact, contact, xp):
    """[B, n] in [0, 1]: how much of the pressure in the middle of the contact a bin bears."""
    half = contact[:, None]
    return xp.maximum(on_contact * (2 * half - on_contact) / half**2, 0.0)


def _share(borne, xp):
    return xp.minimum(borne / BORNE, 1.0)


def _rim(grid, drive, before, after, xp, edge):
    bins = _bins(grid, drive.first[:, PLACE])
    return swept_features.underside(bins, before, after, drive.size[:, :1], xp, edge)


def _level(grid, surface, near, xp):
    """Beds [B, n] that are straight between the bins next to those that are near [B, n] the first
    place; at most up to the nearer end of the bins."""
    index = np.rint(grid.offsets / grid.spacing)
    none, one = xp.zeros_like(surface), xp.ones_like(surface)
    reach = xp.sum(xp.where(near & (index >= 0), one, none), axis=1)[:, None]
    reach = xp.minimum(reach, min(-index[0], index[-1]))
    left, right = (
        xp.sum(xp.where(xp.abs(index - end) < 0.5, surface, none), axis=1)[:, None]
        for end in (-reach, reach)
    )
    between = left + (right - left) * (index + reach) / (2 * reach)
    return xp.where(reach > np.abs(index), between, surface)


def _refuse_outside(grid, state, pose):
    outside = leaves_bins(grid, state, pose)
    if outside.any():
        wheel = int(np.argmax(outside))
        low, high = grid.offsets[[0, -1]]
        raise ValueError(
            f'wheel {wheel} is {pose[wheel, PLACE] - state.first[wheel, PLACE]:.3g} m from its '
            f'first place; with its radius of {state.size[wheel, RADIUS]:.3g} m the bins from '
            f'{low:.3g} to {high:.3g} m do not hold it'
        )


def _checked(values, name, count):
    values = np.asarray(values, np.float64)
    if values.ndim != 2 or values.shape[1] != 4 or count not in (None, len(values)):
        raise ValueError(f'{name} has shape {values.shape}, [{count or "B"}, 4] was expected')
    if not np.isfinite(values).all():
        raise ValueError(
            f'{name} of a wheel is not finite: {values[~np.isfinite(values).all(axis=1)][0]}'
        )
    return values
