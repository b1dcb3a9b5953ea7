"""A blade whose lower edge is round, all of its motion given: pose, swept state, inputs, outline.

A pose is u and height of the middle of the lower edge (m) and lean (rad, positive where the top
lies behind), a size the width w (m). What the edge has swept is `swept`, (1) to (5); beside it the
state knows, with the velocity v = (du_c, dh, dlean)/dt (numbers of docs/swept_field.md),

  area before    A_0(u) = A when e(u) first was below s(u), 0 where it was not                  (6)
  memory         m <- exp(-dt/tau) m + (1 - exp(-dt/tau)) v, for each tau of TIME_SCALES        (7)
  influence      I = clip(3 C(min(q / TOUCH, 1), du / REACH), 0, 1)                             (8)
  disturbed      D = C(q, RISE du), the depth to which soil may have moved                      (9)
  pressed        P <- max(P + (-dh) - STEEP |du_c|, 0) in contact, else 0: how far the edge has
                 gone down into uncut soil without going along                                 (20)

with C the cone of `swept`; in (20) -dh counts below what was cut before, and no network sees P.
A particle may move by a share of what its network says,

  gate           g = I(u) clip((D(u) + below - (s(u) - y)) / below_ramp, 0, 1)
                     clip((w/2 + beside - |z|) / beside_ramp, 0, 1)                            (10)

and the load is 0 in the air: with s_max the highest surface about the edge it is multiplied by

  contact        clip((HEAP_HEIGHT sqrt(A) + CONTACT_ABOVE - (h - rho - s_max)) / CONTACT_RAMP,
                      0, 1)                                                                    (13)
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from learning_to_simulate.tool import swept
from learning_to_simulate.tool.inputs import Row, Table, Tables
from learning_to_simulate.tool.swept import Bed, Frame, SweptBed, SweptGrid
from learning_to_simulate.tool.tool import Tool, way_out

# Half the thickness of the blade of the scenes, m.
EDGE_RADIUS = 0.014
# Memories of the velocity, s: soil and force answer to what the tool did just before.
TIME_SCALES = (0.05, 0.2)
# A place counts as fully cut below this depth, m; between, its influence grows with the depth, so
# that nothing jumps when the tool first touches the soil.
TOUCH = 0.002
# Soil farther than this from all that was cut has not moved, m.
REACH = 0.35
# How steeply the zone that has moved rises away from the cut: rise per length.
RISE = 0.5
# A path that goes down no more than so much for each length that it goes along is a cut; steeper it
# presses. Cuts of the training runs press by 11 mm at most, (20).
STEEP = 8.0
# (3), height of the untouched surface, (5), (6), (8), (9); m, m, m, m2, 1, m.
CHANNELS = ('cut', 'surface', 'since', 'area_before', 'influence', 'disturbed')
CUT, SURFACE, SINCE, AREA_BEFORE, INFLUENCE, DISTURBED = range(6)
# `room` is what is left between the foremost place of the tool and the wall.
SCALARS = (
    'tip', 'height', 'lean', 'speed', 'rise', 'turn',
    *(f'{name}_{i}' for i in range(len(TIME_SCALES)) for name in ('speed', 'rise', 'turn')),
    'area', 'foremost', 'half_width', 'end', 'room', 'pressed',
)  # fmt: skip

# Offsets along the way at which the profile is seen, m: around a particle, and around the edge.
AROUND = (-0.2, -0.13, -0.085, -0.055, -0.035, -0.017, 0.0, 0.017, 0.035, 0.055, 0.085, 0.13,
          0.2)  # fmt: skip
SINCE_AROUND = (-0.1, -0.04, 0.0, 0.04, 0.1)
AT_EDGE = (-0.16, -0.1, -0.06, -0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04, 0.07, 0.11, 0.16)
CONTACT_AROUND = (-0.06, -0.03, 0.0, 0.03, 0.06)
# The tool's last passage fades over so much travel, m.
RECENT = 0.15
# A heap of a swept area stands at most so high above the surface, in roots of the area: a slope of
# 35 degrees on one side of an upright wall.
HEAP_HEIGHT = float(np.sqrt(2.0 * np.tan(np.radians(35.0))))
CONTACT_ABOVE, CONTACT_RAMP = 0.02, 0.01
# Forces are of the order of these: N, N m, for a blade of this width, m.
FORCE, TORQUE, WIDTH = 100.0, 10.0, 0.4
# The load grows a hundredfold where the tool is pressed down: beside its three components the
# network gives the logarithm of a gain, within these limits.
GAIN_LIMIT = 4.0
# A run whose force is less weighs no more than one that has as much, N.
LEAST_FORCE = 10.0

_ABOVE_CUT, _PAST_END = 'y - surface + cut', 'abs(z) - half_width'
_SIZE = 'sqrt(speed**2 + rise**2 + 1e-8)'  # of the velocity, m/s
# How the tool stands. Particles do not see how it moves: slow soil answers to the path alone.
_STANDS = (
    Row('height', 0.05), Row('height', 0.03, 'relu'), Row('lean'),
    Row('area', 0.01), Row('sqrt(relu(area) + 1e-6)', 0.1),
    Row('foremost - tip', 0.1), Row('half_width', 0.2), Row('end - tip'),
)  # fmt: skip
_OWN = (
    Row('tip - u', 0.15), Row('tip - u', 0.03, 'tanh'),
    *(Row('tip - u', 0.05, 'bell', shift) for shift in (-0.08, 0.0, 0.08)),
    Row('y - surface', 0.05), Row('y - height', 0.05), Row('y - height', 0.02, 'tanh'),
    Row('abs(z)', 0.15), Row(_PAST_END, 0.03, 'tanh'), Row(_PAST_END, 0.1, 'tanh'),
    Row(_ABOVE_CUT, 0.05), Row(_ABOVE_CUT, 0.01, 'tanh'),
    Row('foremost - u', 0.15), Row('foremost - u', 0.03, 'tanh'),
    Row('area_before', 0.01), Row('sqrt(area_before + 1e-6)', 0.1),
    Row('end - u'),
    # Sharper where a particle is carried along or left: the ends of the edge, the cut.
    Row(_PAST_END, 0.008, 'tanh'), Row(_PAST_END, 0.02, 'bell'),
    Row(_ABOVE_CUT, 0.004, 'tanh'), Row(_ABOVE_CUT, 0.012, 'bell'),
    Row('at.cut', 0.03, at=AROUND), Row('at.surface - surface', 0.03, at=AROUND),
    Row('at.since', RECENT, 'fade', at=SINCE_AROUND),
)  # fmt: skip
_FORCE = (
    *_STANDS,
    # How the tool moves and has moved.
    Row('speed', 0.02, 'tanh'), Row('rise', 0.02, 'tanh'),
    *(
        Row(name + ending, scale)
        for ending in ('', *(f'_{i}' for i in range(len(TIME_SCALES))))
        for name, scale in (('speed', 0.1), ('rise', 0.1), ('turn', 1.0))
    ),
    Row('at.cut', 0.03, at=AT_EDGE), Row('at.surface - height', 0.05, at=AT_EDGE),
    Row('at.surface - at.cut - height', 0.02, 'tanh', at=AT_EDGE),
    Row('at.since', RECENT, 'fade', at=AT_EDGE),
    *(Row('at.surface - height', 0.05, squash, at=(0.0,)) for squash in ('relu', 'relu2')),
    Row(f'speed / {_SIZE}'), Row(f'rise / {_SIZE}'), Row(_SIZE, 0.03, 'log'), Row(_SIZE, 0.1),
    Row('end - tip', 0.1, 'tanh'),
)  # fmt: skip


class BladeState(NamedTuple):
    """State of B blades; a function of bed and poses so far.

    Attributes:
      swept: see `swept.SweptBed`.
      lean: float64 [B], rad.
      velocity: float64 [B, 3], of u and height (m/s) and lean (rad/s), in the last frame.
      memory: float64 [B, K, 3], (7) for each of the `TIME_SCALES`.
      area_before: float64 [B, n], (6), m2.
      pressed: float64 [B], (20), m.
    """

    swept: SweptBed
    lean: np.ndarray
    velocity: np.ndarray
    memory: np.ndarray
    area_before: np.ndarray
    pressed: np.ndarray


def start(grid: SweptGrid, bed: Bed, pose, velocity=None) -> BladeState:
    """The state at poses [B, 3] before any motion; the tools have had a velocity [B, 3] of these
    for long (None: at rest). ValueError: shapes that do not fit, or values that are not finite."""
    pose = swept.checked('pose', pose, (None, 3))
    velocity = np.zeros_like(pose) if velocity is None else velocity
    velocity = swept.checked('velocity', velocity, pose.shape)
    begun = swept.start(grid, pose[:, :2], bed.surface)
    memory = np.stack([velocity] * len(TIME_SCALES), axis=1)
    none = np.zeros_like(begun.surface)
    return BladeState(begun, pose[:, 2], velocity, memory, none, none[:, 0])


def advance(grid: SweptGrid, state: BladeState, pose, dt) -> BladeState:
    """Moves the tools in a straight line to their next poses [B, 3] within dt (s); the state before
    is not changed.

    Raises:
      ValueError: a duration that is not positive; poses that are not finite or leave the bins.
    """
    swept.check_time(dt)
    pose = swept.checked('pose', pose, (len(state.lean), 3))
    before = state.swept
    after = swept.advance(grid, before, pose[:, :2], dt)
    was_cut, is_cut = before.profile < before.surface, after.profile < after.surface
    area = swept.swept_area(grid, before)[:, None]
    velocity = np.concatenate([after.velocity, (pose[:, 2:] - state.lean[:, None]) / dt], axis=1)
    return BladeState(
        after,
        pose[:, 2],
        velocity,
        swept.faded(state.memory, velocity, dt, TIME_SCALES),  # (7)
        # (6): the area before this frame, so that what is cut together has one value.
        np.where(is_cut & ~was_cut, area, state.area_before),
        _pressed(grid, state, after.position),
    )


def _pressed(grid, state, position):
    """(20) of edges that go on to positions [B, 2]."""
    before = state.swept
    step = position - before.position
    uncut = swept.profile_at(grid, before, position[:, :1])[:, 0]
    bottom = position[:, 1] - grid.radius
    down = np.minimum(bottom - step[:, 1], uncut) - bottom
    pressed = np.maximum(state.pressed + down - STEEP * np.abs(step[:, 0]), 0.0)
    return np.where(bottom > uncut + TOUCH, 0.0, pressed)


def frame(grid: SweptGrid, bed: Bed, width, state: BladeState) -> Frame:
    """What the networks see of a state, of blades of a width [B], m."""
    s = state.swept
    cut = s.surface - s.profile
    bins = np.stack(
        [
            cut,  # (3)
            s.surface - bed.level[:, None],
            np.minimum(s.travelled[:, None] - s.last, grid.forget),  # (5)
            state.area_before,  # (6)
            influence(grid, np.minimum(cut / TOUCH, 1.0), REACH),  # (8)
            swept.cone(cut, RISE * grid.spacing),  # (9)
        ],
        axis=-1,
    )
    of_path = np.stack(
        [
            swept.swept_area(grid, s),  # (4)
            s.foremost - s.origin,
            np.broadcast_to(width, s.origin.shape) / 2,
            bed.end - s.origin,
            bed.end - s.foremost,
            state.pressed,
        ],
        axis=1,
    )
    scalars = np.concatenate(
        [
            s.position - np.stack([s.origin, bed.level], axis=1),
            state.lean[:, None],
            state.velocity,
            state.memory.reshape(len(state.lean), -1),
            of_path,
        ],
        axis=1,
    )
    return Frame(bins.astype(np.float32), scalars.astype(np.float32))


def influence(grid: SweptGrid, touched, reach: float) -> np.ndarray:
    """(8) [B, n] of shares [B, n] in [0, 1] to which places were touched; `reach` in m."""
    return np.clip(3.0 * swept.cone(touched, grid.spacing / reach), 0.0, 1.0)


@dataclasses.dataclass(frozen=True)
class Blade(Tool):
    """A blade as `Tool`, where the methods are explained.

    Attributes:
      width: across the way, m, of runs that do not say their own.
      radius: of the edge, half the thickness, m.
      length: from the middle of the lower to that of the upper edge, m.

    Raises:
      ValueError: a length that is not positive.
    """

    width: float = 0.457
    radius: float = EDGE_RADIUS
    length: float = 0.277

    name = 'blade'
    scalars = SCALARS
    channels = CHANNELS
    tables = Tables(Table(_OWN, 'u'), Table(_STANDS), Table(_FORCE))
    grid = SweptGrid(EDGE_RADIUS, spacing=0.005, behind=0.45, ahead=0.75)
    below, below_ramp, beside, beside_ramp = 0.05, 0.03, 0.3, 0.05
    displacement = 0.03

    def __post_init__(self):
        for field in dataclasses.fields(self):
            if not 0 < getattr(self, field.name) < np.inf:
                raise ValueError(
                    f'Blade.{field.name} must be positive, got {getattr(self, field.name)}'
                )

    def size(self, axes, case, points=None, context=None):
        """See `Tool`; the width that the case states, or the usual one."""
        return np.array([float(case.get('blade_width_m', self.width))])

    def width_of(self, size):
        return float(size[0])

    def poses(self, axes, pose, context=None, before=None):
        return axes.poses(pose)

    def velocity(self, axes, velocity, size):
        return axes.velocities(velocity)

    def begin(self, grid, bed, size, pose, velocity=None):
        state = start(grid, bed, pose, velocity)
        return state, frame(grid, bed, size[:, 0], state)

    def step(self, grid, bed, size, state, pose, dt, heights=None):
        state = advance(grid, state, pose, dt)
        return state, np.asarray(pose, np.float64), frame(grid, bed, size[:, 0], state)

    def touches(self, grid, frames):
        """See `Tool`: where (13) is above 0."""
        tip, height, area = (frames.scalars[:, SCALARS.index(n)] for n in ('tip', 'height', 'area'))
        places = tip[:, None] + np.array(CONTACT_AROUND)
        surface = swept.channels_at(grid, frames.bins[..., SURFACE, None], places).max(axis=(1, 2))
        heap = HEAP_HEIGHT * np.sqrt(np.maximum(area, 0.0))
        return height - self.radius - surface < heap + CONTACT_ABOVE

    def targets(self, episode):
        return episode.load

    def target_weights(self, episode):
        """See `Tool`: runs count alike, whatever their force."""
        size = np.sqrt((episode.load[:, :2].astype(np.float64) ** 2).sum(-1).mean())
        unit = np.array([FORCE, FORCE, TORQUE]) / FORCE
        return 1.0 / (max(size, LEAST_FORCE) * unit) ** 2

    def inside(self, points, pose, size):
        """See `Tool`. A blade is a stadium, all points within its radius of a segment, drawn out
        across the way."""
        points = np.asarray(points, np.float64)
        # From the middle of the lower edge to that of the upper one.
        axis = self.length * np.array([-np.sin(pose[2]), np.cos(pose[2])])
        relative = points[:, :2] - np.asarray(pose)[:2]
        # The nearest point of the segment, and the way from it.
        along = np.clip(relative @ axis / (axis @ axis), 0.0, 1.0)
        away = relative - along[:, None] * axis
        distance = np.hypot(away[:, 0], away[:, 1])
        # On the segment itself there is no nearest side: out to the front.
        front = np.array([axis[1], -axis[0]]) / self.length
        normal = away / np.maximum(distance, 1e-12)[:, None]
        normal = np.where(distance[:, None] > 1e-12, normal, front)
        return way_out(points, self.radius - distance, normal, self.width_of(size))

    def lowest(self, pose, size):
        return float(pose[1]) - self.radius

    def facts(self, episode, pose, frames, loads):
        """Litres that were cut, and the largest force (N) with the blade clear of all soil."""
        height = frames.scalars[:, SCALARS.index('height')] - self.radius
        clear = height - frames.bins[..., SURFACE].max(axis=1) > 0.03
        in_air = clear & (frames.bins[..., CUT].max(axis=1) == 0)
        force = np.linalg.norm(loads[:, :2], axis=1)
        area = frames.scalars[-1, SCALARS.index('area')]
        return {
            'cut_litre': 1e3 * float(area * self.width_of(episode.size)),
            'air_force_N': float(force[in_air].max()) if in_air.any() else 0.0,
        }
