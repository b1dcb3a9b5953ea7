"""`SweptField`: a trained swept field, from paths and beds to soil, force and torque."""

import dataclasses

import numpy as np
import tensorflow as tf

from learning_to_simulate.methods.swept_features import SweptGrid
from learning_to_simulate.methods.swept_field.axes import Axes
from learning_to_simulate.methods.swept_field.network import FieldNetwork
from learning_to_simulate.methods.swept_field.settings import SweptFieldConfig
from learning_to_simulate.methods.swept_field.tool_path import Bed, Frame
from learning_to_simulate.methods.swept_field.tools import Blade, Tool
from learning_to_simulate.scene import Scene

# Frames times particles of one call of the network, so that its memory stays small.
CHUNK = 120_000
# Bins of a blade, and of a wheel, whose radius is that of the run.
GRIDS = {
    'blade': SweptGrid(radius=0.014, spacing=0.005, behind=0.45, ahead=0.75),
    'wheel': SweptGrid(radius=0.014, spacing=0.004, behind=0.3, ahead=0.5),
}


@dataclasses.dataclass
class SweptField:
    """A trained model.

    Attributes:
      config: how it was trained.
      scene: of its data.
      axes, grid: see there.
      tool: a blade or a wheel, see `tools`.
      rest: float64 [N, 3], world, m: the bed at rest that it was trained on.
      kept_spacing, spacing: between the particles of `rest` and between those of the solver, m.
      ranges: name of a scalar -> its range over the training paths; see `quality`.
      calibration: see `quality`.
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
        inputs = self.tool.inputs(self.grid)
        if self.network is None:
            sizes = input_sizes(inputs, self.tool, self.grid)
            self.network = FieldNetwork(self.config, inputs, sizes)
        spec = tf.TensorSpec
        bins = spec([None, len(self.grid.offsets), self.tool.channels])
        scalars = spec([None, len(self.tool.scalars)])
        self._gate = tf.function(inputs.gate, [bins, scalars, spec([None, None, 3])], False)
        self._soil, self._load = {}, {}
        self._specs = bins, scalars, spec([None, None, 3])

    def _functions(self, members):
        if members not in self._soil:
            *frame, rest = self._specs
            network = self.network
            self._soil[members] = tf.function(
                lambda *x: network.displacement(*x, members), [*frame, rest], False
            )
            self._load[members] = tf.function(lambda *x: network.force(*x, members), frame, False)
        return self._soil[members], self._load[members]

    @property
    def blade(self) -> Blade:
        """The blade, for what blades alone have.

        Raises:
          ValueError: another tool.
        """
        if not isinstance(self.tool, Blade):
            raise ValueError(f'a blade is asked for, the tool of this field is a {self.tool.name}')
        return self.tool

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

    def frames(self, bed: Bed, size, pose, dt: float, velocity=None) -> tuple[np.ndarray, Frame]:
        """A whole path of one tool: its poses [T, K], with the height where that is predicted, and
        `Frame` of [T, ...].

        Args:
          bed: of one tool.
          size: [S] and pose: [T, K] of it, see `tools`.
          dt: between poses, s.
          velocity: as of `tools.Tool.begin`, of one tool.

        Raises:
          ValueError: as `tool_path.advance`.
        """
        velocity = None if velocity is None else np.asarray(velocity)[None]
        pose, found = self.tool.frames(
            self.grid, bed, np.asarray(size)[None], np.asarray(pose)[:, None], dt, velocity,
            self.heights,
        )  # fmt: skip
        return pose[:, 0], Frame(found.bins[:, 0], found.scalars[:, 0])

    def warm_up(self, members: int | None = None) -> None:
        """Compiles what a frame needs."""
        bins = np.ones((1, len(self.grid.offsets), self.tool.channels), np.float32)
        frame = Frame(bins, np.ones((1, len(self.tool.scalars)), np.float32))
        self.loads(frame, members)
        self.displacement(frame, np.zeros((1, 3)), members)

    def displacement(self, frames: Frame, rest, members: int | None = None) -> np.ndarray:
        """Displacement of particles from rest.

        Particles that cannot have moved are left out, which is exact: their gate is 0.

        Args:
          frames: [T, ...] of one path.
          rest: [P, 3] from the tool's first place and the level, m (`Episode.local_rest`).
          members: only so many networks; None: all.

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
                values = call(frames.bins[chosen], frames.scalars[chosen], some)
                found[:, chosen, of_any] = values.numpy()
        return found

    def may_move(self, frames: Frame, rest) -> np.ndarray:
        """bool [T, P]: particles that may have moved by a frame; arguments as of
        `displacement`."""
        rest = np.asarray(rest, np.float32)
        step = max(1, 8 * CHUNK // max(1, len(rest)))
        parts = []
        for begin in range(0, len(frames.scalars), step):
            chosen = slice(begin, begin + step)
            n = len(frames.scalars[chosen])
            gate = self._gate(
                frames.bins[chosen], frames.scalars[chosen], np.broadcast_to(rest, (n, *rest.shape))
            )
            parts.append(gate.numpy() > 0)
        return np.concatenate(parts)

    def loads(self, frames: Frame, members: int | None = None) -> np.ndarray:
        """Force along the way and up (N), torque (N m), of a wheel also the change of its height
        (m): float32 [M, T, 3 or 4]; needs no particles."""
        return self._functions(members)[1](frames.bins, frames.scalars).numpy()


def input_sizes(inputs, tool: Tool, grid: SweptGrid) -> tuple[int, int]:
    """Numbers of inputs of both networks."""
    bins = tf.zeros([1, len(grid.offsets), tool.channels])
    scalars = tf.ones([1, len(tool.scalars)])
    return (
        int(inputs.particles(bins, scalars, tf.zeros([1, 1, 3])).shape[-1]),
        int(inputs.force(bins, scalars).shape[-1]),
    )
