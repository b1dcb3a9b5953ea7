"""`SweptField`: a trained swept field, from paths and beds to soil, force and torque; its folder.

A model folder holds `config.json` and `weights.npz`, all that live use needs.
"""

import dataclasses
import functools
import os

import numpy as np
import tensorflow as tf

from learning_to_simulate import checkpoints, known_shapes
from learning_to_simulate.live import poses, soil
from learning_to_simulate.rollout_status import Ranges
from learning_to_simulate.scene import Scene
from learning_to_simulate.swept_field.calibration import conditions, limits_of
from learning_to_simulate.swept_field.network import FieldNetwork
from learning_to_simulate.swept_field.settings import SweptFieldConfig
from learning_to_simulate.tool import TOOLS, bed
from learning_to_simulate.tool.axes import Axes
from learning_to_simulate.tool.bed import Ground
from learning_to_simulate.tool.swept import Frame, SweptGrid
from learning_to_simulate.tool.tool import Tool
from pca_tools import files

# Frames times particles of one call of the network, so that its memory stays small.
CHUNK = 120_000
_REST = 'bed/rest'


@dataclasses.dataclass
class SweptField:
    """A trained model.

    Attributes:
      config: how it was trained.
      scene: of its data.
      axes, grid: see there.
      tool: a blade or a wheel, see `tool`.
      rest: float64 [N, 3], world, m: the bed at rest that it was trained on.
      kept_spacing, spacing: between the particles of `rest` and between those of the solver, m.
      ranges: name of a scalar -> its range over the training paths; see `calibration.limits_of`.
      calibration: 'soil' and 'force' -> weights of the bound, see `calibration`.
      network: the weights.
    """

    config: SweptFieldConfig
    scene: Scene
    axes: Axes
    grid: SweptGrid
    tool: Tool
    rest: np.ndarray
    kept_spacing: float
    spacing: float
    ranges: dict = dataclasses.field(default_factory=dict)
    calibration: dict = dataclasses.field(default_factory=dict)
    network: FieldNetwork | None = None

    def __post_init__(self):
        if self.network is None:
            self.network = FieldNetwork(self.config, self.tool, self.grid)
        spec, tool = tf.TensorSpec, self.tool
        frame = [spec([None, len(self.grid.offsets), len(tool.channels)]),
                 spec([None, len(tool.scalars)])]  # fmt: skip
        gate = self.network.inputs.gate
        self._gate = tf.function(gate, [*frame, spec([None, None, 3])], False)

        @functools.cache
        def functions(members):
            network = self.network
            return (
                tf.function(
                    lambda *x: network.displacement(*x, members), [*frame, spec([None, None, 3])],
                    False,
                ),
                tf.function(lambda *x: network.force(*x, members), frame, False),
            )  # fmt: skip

        self._functions = functions

    @property
    def limits(self) -> Ranges:
        """What frames are judged by."""
        return limits_of(self.ranges, self.tool.scalars)

    @functools.cached_property
    def extent(self) -> np.ndarray:
        """float64 [2, 2], m: of the bed at rest seen from above, see `soil.plan_extent`."""
        return soil.plan_extent(self.rest, self.axes.up)

    def ground(self, u: float, size, given=None) -> Ground:
        """The bed of a tool that begins at u (m).

        Args:
          u: along the way.
          size: [S] of the tool.
          given: [N, 3] particles, m, or a `bed.HeightMap`; None for the flat bed of the training.

        Raises:
          ValueError: not a bed.
        """
        # A view, so that who closes it for writing does not close the field's own.
        points, kept = self.rest.view(), self.kept_spacing
        if isinstance(given, bed.HeightMap):
            points = bed.stretched(given, self.rest, self.axes, self.spacing)
        elif given is not None:
            points = poses.numbers('bed', given, (None, 3))
            if not len(points):
                raise ValueError('a bed of no particles')
            kept *= (len(self.rest) / len(points)) ** (1 / 3)
        width = self.tool.width_of(size)
        return bed.ground(points, u, size, width, self.axes, self.grid, kept, self.spacing)

    def context(self, values) -> dict | None:
        """Name -> [...] of values [..., C] of the scene's context; None for None."""
        if values is None:
            return None
        return dict(zip(self.scene.context_names, np.moveaxis(np.asarray(values), -1, 0)))

    def check_contexts(self, values) -> None:
        """Refuses contexts [T, C] that a tool cannot have one after the other.

        Raises:
          ValueError: gravity or a load that is not positive; something else than the load changes.
        """
        for name, row in self.context(values).items():
            if name in ('gravity', 'load') and not (row > 0).all():
                raise ValueError(f'the {name} is {row[~(row > 0)][0]:g}, must be positive')
            changes = np.flatnonzero(~np.isclose(row[1:], row[:-1]))
            if name != 'load' and len(changes):
                now, last = row[changes[0] + 1], row[changes[0]]
                raise ValueError(
                    f'{name} cannot change on the way, from {last:g} to {now:g}; begin anew'
                )

    def heights(self, frames: Frame, members: int | None = None) -> np.ndarray:
        """Change [T] of the tool's height since its first frame (m), where it is predicted; sees
        only what is given of a path."""
        return self.loads(frames, members)[..., 3].mean(axis=0).astype(np.float64)

    def frames(self, ground: Ground, pose, dt: float, velocity=None) -> tuple[np.ndarray, Frame]:
        """A whole path of one tool: its poses [T, K], with the height where that is predicted, and
        `Frame` of [T, ...].

        Args:
          ground: that it begins on.
          pose: [T, K], see `tool`.
          dt: between poses, s.
          velocity: as of `Tool.begin`, of one tool.

        Raises:
          ValueError: as `swept.advance`.
        """
        velocity = None if velocity is None else np.asarray(velocity)[None]
        pose, found = self.tool.frames(
            self.grid, ground.bed, ground.size[None], np.asarray(pose)[:, None], dt, velocity,
            self.heights,
        )  # fmt: skip
        return pose[:, 0], found.at((slice(None), 0))

    def judged(self, path, frames: Frame, dt: float, before=None) -> np.ndarray:
        """What `limits` judges of a path: `calibration.conditions` [T, J].

        Args:
          path: [T, 7] poses of the world.
          frames: of them.
          dt: between them, s.
          before: [7], the pose before the first; None: the first itself.
        """
        earlier = np.concatenate([path[:1] if before is None else before[None], path[:-1]])
        in_soil = self.tool.touches(self.grid, frames)
        return conditions(self.axes, path, earlier, dt, frames, in_soil)

    def warm_up(self, members: int | None = None) -> None:
        """Compiles what a frame needs."""
        bins = np.ones((1, len(self.grid.offsets), len(self.tool.channels)), np.float32)
        frame = Frame(bins, np.ones((1, len(self.tool.scalars)), np.float32))
        self.loads(frame, members)
        self.displacement(frame, np.zeros((1, 3)), members)

    def displacement(self, frames: Frame, rest, members: int | None = None) -> np.ndarray:
        """Displacement of particles from rest.

        Particles that cannot have moved are left out, which is exact: their gate is 0.

        Args:
          frames: [T, ...] of one path.
          rest: [P, 3] from the tool's first place and the level, m (`Ground.local`).
          members: number of networks that are used; None: all.

        Returns:
          float32 [M, T, P, 3], m, along the way, up, across.
        """
        rest = np.asarray(rest, np.float32)
        moving = self.may_move(frames, rest)
        count = self.config.members if members is None else members
        found = np.zeros((count, len(frames.scalars), len(rest), 3), np.float32)
        call, _ = self._functions(members)
        step = max(1, CHUNK // max(1, int(moving.any(axis=0).sum())))
        for begin in range(0, len(found[0]), step):
            chosen = slice(begin, begin + step)
            of_any = np.flatnonzero(moving[chosen].any(axis=0))
            if len(of_any):
                n = len(frames.scalars[chosen])
                some = np.broadcast_to(rest[of_any], (n, len(of_any), 3))
                found[:, chosen, of_any] = call(*frames.at(chosen), some).numpy()
        return found

    def may_move(self, frames: Frame, rest) -> np.ndarray:
        """bool [T, P]: particles that may have moved by a frame; arguments as of
        `displacement`."""
        rest = np.asarray(rest, np.float32)
        step = max(1, 8 * CHUNK // max(1, len(rest)))
        parts = []
        for begin in range(0, len(frames.scalars), step):
            some = frames.at(slice(begin, begin + step))
            of_each = np.broadcast_to(rest, (len(some.scalars), *rest.shape))
            parts.append(self._gate(*some, of_each).numpy() > 0)
        return np.concatenate(parts)

    def loads(self, frames: Frame, members: int | None = None) -> np.ndarray:
        """Force along the way and up (N), torque (N m), of a wheel also the change of its height
        (m): float32 [M, T, 3 or 4]; needs no particles."""
        return self._functions(members)[1](*frames).numpy()


class SweptSoil(soil.Soil):
    """The soil of one frame of a tool on its bed; nothing is computed before it is asked for.

    Attributes:
      field: `SweptField`.
      frame: `Frame` of [1, ...].
      pose: float64 [K] of the tool, see `tool`.
      ground: the bed.
      subspace: for those who want modes, or None.
      members: networks that answer; None: all.
    """

    def __init__(self, field, frame: Frame, pose, ground: Ground, subspace=None, members=None):
        self.field, self.frame, self.pose, self.ground = field, frame, pose, ground
        self.subspace, self.members = subspace, members
        self.up_axis = field.axes.up

    @property
    def extent(self) -> np.ndarray:  # type: ignore[override]
        """See `Soil`."""
        return self.field.extent

    def particles(self) -> np.ndarray:
        """float32 [N, 3], world, m; none of it inside the tool."""
        field, ground = self.field, self.ground
        moved = field.displacement(self.frame, ground.local, self.members)
        # Those that rest are as they were given, to the last bit.
        now = np.flatnonzero(moved[:, 0].any(axis=(0, 2)))
        points = ground.points.astype(np.float32)
        there = ground.places[now] + moved[:, 0, now].mean(axis=0)
        there = there + field.tool.inside(there, self.pose, ground.size)[1]
        points[now] = ground.points[now] + field.axes.world(there - ground.places[now])
        return points


def _weights(field: SweptField) -> dict:
    """Name -> variable, the same in every process."""
    return {
        f'{name}/{i}/{kind}': variable
        for name, part in (('soil', field.network.soil), ('load', field.network.load))
        for i, layer in enumerate(part.layers)
        for kind, variable in zip(('weight', 'bias'), layer, strict=True)
    }


def save(path: str, field: SweptField, data: dict, written: dict | None = None) -> None:
    """Writes a model folder, config.json last: it says that the rest is there.

    Args:
      path: folder, present.
      field: the model.
      data: where its training data came from, for the record.
      written: of `starts.write`.

    Raises:
      ValueError: weights that are not finite; nothing is written.
    """
    arrays = {name: v.numpy() for name, v in _weights(field).items()}
    if bad := [name for name, v in arrays.items() if not np.isfinite(v).all()]:
        raise ValueError(f'{path}: not saved, weights are not finite: {bad[:3]}')
    arrays[_REST] = field.rest.astype(np.float32)
    files.write_npz(os.path.join(path, checkpoints.WEIGHTS_FILE), **arrays)
    files.write_json(
        os.path.join(path, checkpoints.CONFIG_FILE),
        {
            'schema_version': checkpoints.SCHEMA_VERSION,
            'config': dataclasses.asdict(field.config),
            'scene': field.scene.to_json(),
            'field': {
                'axes': dataclasses.asdict(field.axes),
                'grid': dataclasses.asdict(field.grid),
                field.tool.name: dataclasses.asdict(field.tool),
                'kept_spacing': field.kept_spacing,
                'spacing': field.spacing,
                'ranges': field.ranges,
                'calibration': field.calibration,
            },
            'data': data,
            'files': written or {},
        },
    )


def load(path: str) -> SweptField:
    """Reads a model folder.

    Raises:
      FileNotFoundError: no model there.
      ValueError: a damaged one, or one of another method.
    """
    stored = checkpoints.read_config(path)
    where = os.path.join(path, checkpoints.CONFIG_FILE)
    weights_path = os.path.join(path, checkpoints.WEIGHTS_FILE)
    try:
        config = SweptFieldConfig(**stored['config'])
        scene = Scene.from_json(stored['scene'])
        values = stored['field']
        parts = {
            'axes': Axes(**values['axes']),
            'grid': SweptGrid(**values['grid']),
            'tool': next(t(**values[n]) for n, t in TOOLS.items() if n in values),
            'kept_spacing': float(values['kept_spacing']),
            'spacing': float(values['spacing']),
            'ranges': {k: [float(x) for x in v] for k, v in values['ranges'].items()},
            'calibration': {k: [float(x) for x in v] for k, v in values['calibration'].items()},
        }
        limits_of(parts['ranges'], parts['tool'].scalars)  # type: ignore[attr-defined]
    except (KeyError, TypeError, ValueError, AttributeError, StopIteration) as error:
        raise ValueError(f'{where}: a field is missing, unknown or wrong ({error!r})') from error
    arrays = checkpoints.stored_weights(path)
    with known_shapes.only((w.shape for w in arrays.values()), weights_path):
        field = SweptField(config, scene, rest=np.zeros((0, 3)), **parts)
    variables = _weights(field)
    shapes = {name: tuple(v.shape) for name, v in variables.items()}
    checkpoints.check_weights(path, arrays, shapes | {_REST: _rest_shape(arrays)})
    for name, variable in variables.items():
        variable.assign(arrays[name])
    field.rest = arrays[_REST].astype(np.float64)
    return field


def _rest_shape(arrays):
    """[N, 3] of the stored bed; any N fits."""
    shape = arrays.get(_REST, np.zeros((0, 3))).shape
    return shape if len(shape) == 2 and shape[1] == 3 else (0, 3)
