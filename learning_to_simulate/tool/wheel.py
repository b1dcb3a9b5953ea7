"""A driven wheel: turn, travel and load are given, the height is predicted. Pose, state, inputs.

A pose is u, height of the axle (m), angle turned (rad, positive where it rolls on) and load N;
a size is radius R and width (m), gravity (m/s2) and tan of the friction angle.

The state has two halves. The *drive* is a function of what is given; from it a network tells force,
torque and height. The *rut* follows from the height. Neither waits for the other over time: heights
of all frames come from one call. With the first sinkage z, and du_c, dalpha, dN of travel, turn and
load in a step ((18) is that of docs/swept_field.md),

  contact        a = sqrt(z (2 R - z)): half the chord in which the rim first cuts the surface
  bearing        B = max(1 - (u - u_c)^2 / a^2, 0), of the pressure in the middle
  slip           ds = R dalpha - du_c
  slid, shear    slid <- slid + B |ds|, shear <- shear + B ds, B the mean of both ends         (18)
  peak           peak <- max(peak, min(B / BORNE, 1) N)                                        (18)
  stirred        k = min(sum |du_c| / STIR + sum |ds| / STIR + sum |dN| / (STIR_LOAD N_0), 1)
  rut            (1) to (4) of `swept` by the rim, once the height is known
  influence      k times (8) of `blade`, of max(peak / N_0, min(q / TOUCH, 1))

with N_0 the first load. Gate and disturbed depth are (10) and (9) of `blade`.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.tool import blade, swept
from learning_to_simulate.tool.inputs import Row, Table, Tables
from learning_to_simulate.tool.swept import Bed, Frame, SweptGrid
from learning_to_simulate.tool.tool import Tool, way_out

# Names that a scene's context must have, by which a wheel's load and soil are known.
CONTEXT = ('gravity', 'friction_angle_deg', 'load')
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
# The first two and the last two are those of a blade; `first_cut` is that of the wheel set down.
CHANNELS = ('cut', 'surface', 'first_cut', 'since', 'slid', 'shear', 'peak', 'influence',
            'disturbed')  # fmt: skip
CUT, SURFACE, FIRST_CUT, SINCE, SLID, SHEAR, PEAK, INFLUENCE, DISTURBED = range(9)
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
_S = {name: i for i, name in enumerate(SCALARS)}
# Those that hang on the predicted height; they are not asked for by the force.
_N_DRIVE = len(SCALARS) - 2

# Density of the soil that loads are compared with, kg/m3.
DENSITY = 1700.0
# Offsets at which the drive is seen, in halves of the contact, and the rut and the slip, m.
AT_CONTACT = (-3.0, -2.0, -1.4, -1.0, -0.6, -0.25, 0.0, 0.25, 0.6, 1.0, 1.4, 2.0)
AROUND = (-0.12, -0.075, -0.045, -0.025, -0.01, 0.0, 0.01, 0.025, 0.045, 0.075, 0.12)
SLIP_AROUND = (-0.06, -0.025, 0.0, 0.025, 0.06)
# The last passage fades over so much travel, slip is mobilised over so much, m.
RECENT, SHEARED = 0.05, 0.004
# The vertical force departs from the load by this share.
VERTICAL = 0.05
LEAST_SUNK = 0.002  # m, added to the first sinkage where changes are compared with it
# A run whose height changes by less weighs no more than one that has as much, m.
LEAST_SINKAGE = 0.001

# What wheel it is, on what soil, and how far it has gone. Few, and without dimension: lengths of
# the contact, loads over the first, that over the weight of a block of soil. With gravity, radius,
# width and load each for itself the sinkage of unseen wheels was worse by a fifth.
_DRIVE = (
    Row(f'log(first_load / ({DENSITY} * gravity * radius**2 * 2 * half_width))', 2.0),
    Row('friction', 0.15, shift=0.75), Row('radius', 0.075, 'log'),
    Row(f'log(max(sunk, {LEAST_SUNK}) / radius)'),
    Row('load / first_load - 1.0'), Row('peak_load / first_load - 1.0'),
    Row('tip / contact', 3.0), Row('tip / contact', squash='tanh'),
    Row('abs(tip) / (0.3 * contact)', squash='tanh'),
    Row('rolled / contact', 3.0), Row('rolled / contact', squash='tanh'),
    Row(f'log1p(slipped / {SHEARED})', 2.0), Row('slipped / contact', squash='log1p'),
    Row('travelled / contact', squash='log1p'),
    Row('(foremost - tip) / contact'), Row('(tip - rearmost) / contact'),
    Row('foremost / contact', squash='tanh'), Row('rearmost / contact', squash='tanh'),
)  # fmt: skip
_ABOVE_CUT, _PAST_END = 'y - surface + cut', 'abs(z) - half_width'
# How far a particle is from the rim, now and when the wheel was set down.
_FROM_RIM = 'sqrt((tip - u)**2 + (y - height)**2 + 1e-8) - radius'
_AT_FIRST = 'sqrt(u**2 + (y - radius + sunk)**2 + 1e-8) - radius'
_OWN = (
    Row('tip - u', 0.1), Row('tip - u', 0.015, 'tanh'), Row('(tip - u) / contact', squash='tanh'),
    *(Row('(tip - u) / contact', 1.0, 'bell', shift) for shift in (-1.0, 0.0, 1.0)),
    Row('u', 0.1), Row('u / contact', squash='tanh'),
    Row('(foremost - u) / contact', squash='tanh'), Row('(rearmost - u) / contact', squash='tanh'),
    Row('y - surface', 0.03), Row('y - surface', 0.01, 'tanh'), Row('y - height + radius', 0.03),
    Row(_FROM_RIM, 0.03), Row(_FROM_RIM, 0.01, 'tanh'), Row(_AT_FIRST, 0.01, 'tanh'),
    Row('abs(z)', 0.06), Row(_PAST_END, 0.015, 'tanh'), Row(_PAST_END, 0.04, 'tanh'),
    Row(_ABOVE_CUT, 0.02), Row(_ABOVE_CUT, 0.005, 'tanh'),
    Row('end - u'),
    Row('at.cut', 0.02, at=AROUND), Row('at.cut - at.first_cut', 0.01, at=AROUND),
    Row('at.surface - surface', 0.02, at=AROUND),
    Row('at.since', RECENT, 'fade', at=SLIP_AROUND),
    Row('at.slid', SHEARED, 'log1p', at=SLIP_AROUND),
    Row('at.shear', SHEARED, 'tanh', at=SLIP_AROUND), Row('at.shear', 0.03, at=SLIP_AROUND),
    Row('at.peak / first_load', at=SLIP_AROUND),
)  # fmt: skip
_FORCE = (
    *_DRIVE,
    # How the wheel slips and has slipped: no speed, slow soil answers to the path alone. 1 mm/s.
    *(
        Row(f'{what} / sqrt(speed{i}**2 + rim{i}**2 + 1e-6)')
        for i in ('', *(f'_{k}' for k in range(len(TIME_SCALES))))
        for what in (f'(rim{i} - speed{i})', f'rim{i}', f'speed{i}')
    ),
    Row('at.since', RECENT, 'fade', at=AT_CONTACT),
    Row(f'log1p(at.slid / {SHEARED})', 2.0, at=AT_CONTACT),
    Row('at.shear', SHEARED, 'tanh', at=AT_CONTACT), Row('at.peak / first_load', at=AT_CONTACT),
    Row('end - tip', 0.1, 'tanh'),
)  # fmt: skip


class DriveState(NamedTuple):
    """What is given of B wheels so far.

    Attributes:
      size: float64 [B, 4].
      first: float64 [B, 4] first pose.
      sunk: float64 [B] how deep the rim stood in the bed at first, m.
      contact: float64 [B], a, m.
      pose: float64 [B, 4], the height of no meaning.
      velocity: float64 [B, 2] of travel and of the rim, m/s.
      memory: float64 [B, K, 2] the same, (7) for each of the `TIME_SCALES`.
      frame_load: float64 [B] mean load of the last frame, N.
      peak_load: float64 [B] N.
      reach: float64 [B, 2] rearmost and foremost u, m.
      way: float64 [B, 3] travelled, slipped and loaded in all, whatever the sign; m, m, and shares
        of the first load.
      since: float64 [B, n] distance travelled since a bin was last borne on, m; at first
        `grid.forget` where none was.
      slid, shear: float64 [B, n], (18), m.
      peak: float64 [B, n], (18), N.
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


def start(grid: SweptGrid, bed: Bed, size, pose, velocity=None) -> tuple[DriveState, Rut]:
    """The state before any motion of wheels of a size and pose [B, 4], whose first height is known;
    they have had a velocity [B, 2] of travel and rim (m/s) for long. ValueError: shapes that do
    not fit, or values that are not finite."""
    size = swept.checked('size', size, (None, 4))
    pose = swept.checked('pose', pose, (len(size), 4))
    velocity = np.zeros_like(pose[:, :2]) if velocity is None else np.asarray(velocity, np.float64)
    radius, place, load = size[:, RADIUS], pose[:, PLACE], pose[:, LOAD]
    sunk = bed.level - (pose[:, HEIGHT] - radius)
    depth = np.maximum(sunk, 0.002)
    # Half the chord of a circle at a depth z below its lowest point: sqrt(z (2 R - z)).
    chord = np.sqrt(np.maximum(depth * (2 * radius - depth), 0.0))
    contact = np.where(depth < radius, chord, radius)  # no root is the radius to the last digit
    edge = _within_rim(grid, place, size, place)
    on_contact = _on_contact(edge, radius, contact)
    borne = _bearing(on_contact, contact)
    none, still = np.zeros_like(bed.surface), np.zeros_like(place)
    drive = DriveState(
        size, pose, sunk, contact, pose, velocity, np.stack([velocity] * len(TIME_SCALES), axis=1),
        load, load, np.stack([place] * 2, axis=1), np.stack([still] * 3, axis=1),
        np.where(borne > 0, none, np.full_like(none, grid.forget)), none, none,
        np.minimum(borne / BORNE, 1.0) * load[:, None],
    )  # fmt: skip
    # Before the wheel was set down the bed was level with what lies beside the contact.
    near = (edge > 0) & (on_contact + 2 * grid.spacing > 0)
    surface = _level(grid, bed.surface, near)
    profile = np.minimum(surface, _rim(grid, drive, pose[:, :2], pose[:, :2]))
    return drive, Rut(surface, profile, profile, pose[:, :2])


def drive_on(grid: SweptGrid, state: DriveState, pose, dt) -> DriveState:
    """The drives dt s later at poses [B, 4], whose height is ignored: (18). The state before is not
    changed. ValueError: a duration that is not positive; poses that are not finite or leave the
    bins."""
    swept.check_time(dt)
    pose = swept.checked('pose', pose, (len(state.pose), 4))
    first, radius, contact = state.first[:, PLACE], state.size[:, RADIUS], state.contact
    grid.check_within(pose[:, PLACE] - first, radius)
    gone = pose - state.pose
    step = np.stack([gone[:, PLACE], radius * gone[:, TURNED]], axis=1)
    velocity = step / dt
    # ds = R dalpha - du_c: the rim against the soil.
    slip = (step[:, 1] - step[:, 0])[:, None]
    # What a place bears in a frame is the mean of that at both ends.
    before, after = (
        _bearing(_on_contact(_within_rim(grid, first, state.size, end), radius, contact), contact)
        for end in (state.pose[:, PLACE], pose[:, PLACE])
    )
    borne = (before + after) / 2
    place, load = pose[:, PLACE], pose[:, LOAD]
    loaded = np.abs(load - state.pose[:, LOAD]) / np.maximum(state.first[:, LOAD], 1e-9)
    far = np.abs(step[:, :1])
    return state._replace(
        pose=pose,
        velocity=velocity,
        memory=swept.faded(state.memory, velocity, dt, TIME_SCALES),
        frame_load=(load + state.pose[:, LOAD]) / 2,
        peak_load=np.maximum(state.peak_load, load),
        reach=np.stack(
            [np.minimum(state.reach[:, 0], place), np.maximum(state.reach[:, 1], place)], axis=1
        ),
        way=state.way + np.concatenate([far, np.abs(slip), loaded[:, None]], axis=1),
        since=np.where(after > 0, np.zeros_like(after), state.since + far),
        # (18)
        slid=state.slid + borne * np.abs(slip),
        shear=state.shear + borne * slip,
        peak=np.maximum(state.peak, np.minimum(after / BORNE, 1.0) * load[:, None]),
    )


def sink(grid: SweptGrid, drive: DriveState, rut: Rut, height) -> Rut:
    """The ruts once the wheels of a drive stand at heights [B], m."""
    position = np.stack([drive.pose[:, PLACE], height], axis=1)
    rim = _rim(grid, drive, rut.position, position)
    return rut._replace(profile=np.minimum(rut.profile, rim), position=position)


def frame(grid: SweptGrid, bed: Bed, drive: DriveState, rut: Rut | None = None) -> Frame:
    """What the networks see of a state; without a rut, what the force and the height see: the rest
    is 0."""
    first, radius = drive.first[:, PLACE], drive.size[:, RADIUS]
    none, zero = np.zeros_like(drive.slid), np.zeros_like(first)
    bins = np.stack(
        [none] * 3
        + [np.minimum(drive.since, grid.forget), drive.slid, drive.shear, drive.peak]
        + [none] * 2,
        axis=-1,
    )
    # k: nothing moves before the wheel stirs.
    stirred = np.sum(drive.way / np.array([STIR, STIR, STIR_LOAD]), axis=1)
    gone = [
        drive.pose[:, PLACE] - first,
        radius * (drive.pose[:, TURNED] - drive.first[:, TURNED]),
    ]
    rest = [
        drive.way[:, 0], drive.way[:, 1], drive.reach[:, 1] - first, drive.reach[:, 0] - first,
        drive.pose[:, LOAD], drive.frame_load, drive.peak_load, drive.first[:, LOAD],
        radius, drive.size[:, WIDTH] / 2, drive.size[:, GRAVITY], drive.size[:, FRICTION],
        drive.sunk, drive.contact, bed.end - first, bed.end - drive.reach[:, 1],
        np.clip(stirred, 0.0, 1.0), zero, zero,
    ]  # fmt: skip
    scalars = np.concatenate(
        [
            np.stack(gone, axis=1),
            drive.velocity,
            drive.memory.reshape(len(first), -1),
            np.stack(rest, axis=1),
        ],
        axis=1,
    )
    known = Frame(bins.astype(np.float32), scalars.astype(np.float32))
    return known if rut is None else with_rut(grid, bed, known, rut)


def with_rut(grid: SweptGrid, bed: Bed, known: Frame, rut: Rut) -> Frame:
    """A frame of the drive with what the rut adds to it."""
    cut = rut.surface - rut.profile
    first_load, stirred = (known.scalars[:, _S[n], None] for n in ('first_load', 'stirred'))
    # Soil is touched where it bore the wheel or was cut, (8) of `blade`.
    borne = np.minimum(known.bins[..., PEAK] / np.maximum(first_load, 1e-9), 1.0)
    touched = np.maximum(borne, np.minimum(cut / blade.TOUCH, 1.0))
    seen = [cut, rut.surface - bed.level[:, None], rut.surface - rut.first]
    reached = [
        blade.influence(grid, touched, REACH) * stirred,
        swept.cone(cut, RISE * grid.spacing),
    ]
    area = grid.spacing * np.sum(rut.first - rut.profile, axis=1)
    of_rut = np.stack([rut.position[:, 1] - bed.level, area], axis=1)
    before, after = (np.stack(part, axis=-1).astype(np.float32) for part in (seen, reached))
    return Frame(
        np.concatenate([before, known.bins[..., SINCE:INFLUENCE], after], axis=-1),
        np.concatenate([known.scalars[:, :_N_DRIVE], of_rut.astype(np.float32)], axis=1),
    )


def _within_rim(grid, first, size, place):
    """[B, n] how far bins lie within the rim of wheels at places [B] along the way, m."""
    return size[:, :1] - np.abs(first[:, None] + grid.offsets - place[:, None])


def _on_contact(edge, radius, contact):
    """How far bins lie within the contact, from how far they lie within the rim, m."""
    return edge - (radius - contact)[:, None]


def _bearing(on_contact, contact):
    """The share B of bins that lie so far [B, n] within the contact [B], m."""
    half = contact[:, None]
    return np.maximum(on_contact * (2 * half - on_contact) / half**2, 0.0)


def _rim(grid, drive, before, after):
    bins = drive.first[:, PLACE, None] + grid.offsets
    return swept.underside(bins, before, after, drive.size[:, :1])


def _level(grid, surface, near):
    """Beds [B, n] that are straight between the bins next to those that are near [B, n] the first
    place; at most up to the nearer end of the bins."""
    index = np.rint(grid.offsets / grid.spacing)
    reach = np.sum(near & (index >= 0), axis=1, keepdims=True).astype(float)
    reach = np.minimum(reach, min(-index[0], index[-1]))
    left, right = (
        np.sum(np.where(np.abs(index - end) < 0.5, surface, 0.0), axis=1, keepdims=True)
        for end in (-reach, reach)
    )
    between = left + (right - left) * (index + reach) / (2 * reach)
    return np.where(reach > np.abs(index), between, surface)


@dataclasses.dataclass(frozen=True)
class Wheel(Tool):
    """A driven wheel as `Tool`, where the methods are explained."""

    name = 'wheel'
    scalars = SCALARS
    channels = CHANNELS
    tables = Tables(
        Table(_OWN, 'u'),
        Table((*_DRIVE, Row('height - radius', 0.02))),
        Table(_FORCE, unit='contact'),
    )
    # The radius is that of each wheel; that of the grid is not used.
    grid = SweptGrid(blade.EDGE_RADIUS, spacing=0.004, behind=0.3, ahead=0.5)
    below, below_ramp, beside, beside_ramp = 0.05, 0.02, 0.08, 0.03
    displacement = 0.01
    predicts_height = True

    def size(self, axes, case, points=None, context=None):
        points = axes.points(points)
        spokes = points[:, :2] - points[:, :2].mean(axis=0)
        friction = np.tan(np.pi / 180 * context['friction_angle_deg'])
        width = np.ptp(points[:, 2])
        return np.array([np.hypot(*spokes.T).mean(), width, context['gravity'], friction])

    def width_of(self, size):
        return float(size[WIDTH])

    def poses(self, axes, pose, context=None, before=None):
        u, height, lean = np.moveaxis(axes.poses(pose), -1, 0)
        # Angles go on beyond a turn: from the frame before, in the nearest multiple of 2 pi.
        first = -lean[:1] if before is None else before[None, TURNED]
        turned = np.unwrap(np.concatenate([first, -lean]))[1:]
        return np.stack([u, height, turned, np.broadcast_to(context['load'], u.shape)], axis=-1)

    def velocity(self, axes, velocity, size):
        """See `Tool`: of travel and rim."""
        rates = axes.velocities(velocity)
        return np.stack([rates[0], -rates[2] * size[RADIUS]])

    def begin(self, grid, bed, size, pose, velocity=None):
        drive, rut = start(grid, bed, size, pose, velocity)
        return (drive, rut), frame(grid, bed, drive, rut)

    def step(self, grid, bed, size, state, pose, dt, heights=None):
        drive, rut = state
        drive = drive_on(grid, drive, pose, dt)
        known = frame(grid, bed, drive)
        pose = np.array(pose, np.float64)
        if heights is not None:
            pose[:, HEIGHT] = drive.first[:, HEIGHT] + heights(known)
        rut = sink(grid, drive, rut, pose[:, HEIGHT])
        return (drive, rut), pose, with_rut(grid, bed, known, rut)

    def frames(self, grid, bed, size, pose, dt, velocity=None, heights=None):
        """See `Tool`: all drives, then all heights from one call, then all ruts."""
        pose = np.array(pose, np.float64)
        (drive, rut), first = self.begin(grid, bed, size, pose[0], velocity)
        drives, known = [drive], [frame(grid, bed, drive)]
        for coming in pose[1:]:
            drives.append(drive_on(grid, drives[-1], coming, dt))
            known.append(frame(grid, bed, drives[-1]))
        # Frames of the drive do not hang on heights, so one call gives those of all frames.
        if heights is not None and len(pose) > 1:
            flat = Frame(*(np.concatenate(x) for x in zip(*known[1:], strict=True)))
            change = heights(flat).reshape(len(pose) - 1, -1)
            pose[1:, :, HEIGHT] = pose[0, :, HEIGHT] + change
        found = [first]
        for k, one, row in zip(known[1:], drives[1:], pose[1:], strict=True):
            rut = sink(grid, one, rut, row[:, HEIGHT])
            found.append(with_rut(grid, bed, k, rut))
        return pose, Frame(*map(np.stack, zip(*found, strict=True)))

    def touches(self, grid, frames):
        """See `Tool`: a driven wheel always does."""
        return np.ones(len(frames.scalars), bool)

    def targets(self, episode):
        """See `Tool`: the last one is the change of the height, m."""
        height = episode.pose[:, HEIGHT]
        return np.concatenate(
            [episode.load, (height - height[0])[:, None]], axis=1, dtype=np.float32
        )

    def target_weights(self, episode):
        """See `Tool`: forces over that of the run, torque over force times radius, height over
        that of the run."""
        force = np.sqrt((episode.load[:, :2].astype(np.float64) ** 2).sum(-1).mean())
        change = self.targets(episode)[:, 3].astype(np.float64)
        height = max(float(np.sqrt((change**2).mean())), LEAST_SINKAGE)
        return 1.0 / np.array([force, force, force * episode.size[RADIUS], height]) ** 2

    def inside(self, points, pose, size):
        """See `Tool`: a disc."""
        points = np.asarray(points, np.float64)
        away = points[:, :2] - np.asarray(pose)[:2]
        distance = np.hypot(away[:, 0], away[:, 1])[:, None]
        # On the axle there is no nearest side: down.
        normal = np.where(distance > 1e-12, away / np.maximum(distance, 1e-12), [0.0, -1.0])
        return way_out(points, size[RADIUS] - distance[:, 0], normal, size[WIDTH])

    def lowest(self, pose, size):
        return float(pose[HEIGHT] - size[RADIUS])

    def facts(self, episode, pose, frames, loads):
        """Errors of the sinkage: root mean square (mm), over the radius, and of a height that is
        held; the relative L2 error of a force that is held, and of the torque."""
        true, said = (p[H:, HEIGHT] for p in (episode.pose, pose))
        held = episode.pose[H - 1, HEIGHT]
        size = np.linalg.norm(episode.load[H:, :2])
        radius = episode.size[RADIUS]
        error = np.sqrt(((said - true) ** 2).mean())
        return {
            'height_mm': float(1e3 * error),
            'height_over_radius': float(error / radius),
            'height_worst_over_radius': float(np.abs(said - true).max() / radius),
            'held_height_mm': float(1e3 * np.sqrt(((held - true) ** 2).mean())),
            'held_force_l2': float(
                np.linalg.norm(episode.load[H:, :2] - episode.load[H - 1, :2]) / size
            ),
            'torque_l2': float(
                np.linalg.norm(loads[H:, 2] - episode.load[H:, 2])
                / max(np.linalg.norm(episode.load[H:, 2]), 1e-9)
            ),
        }
