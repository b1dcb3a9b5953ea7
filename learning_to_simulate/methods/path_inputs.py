"""The numbers that `path_ridge` sees: functions of the known motion up to a frame.

`path`: pose, velocity, deepest and foremost point so far, swept area (a blade), or travel, turn,
slip, their rates, logarithms of the context and the size (a wheel). `swept` adds the profile of the
deepest cut, from where the tool began; `bed` adds where on the bed that was and the profile at
places that are the same in all runs, as the particles of the modes are (a blade; a wheel's height
is not known, so nor is its rut).
"""

import dataclasses

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.methods import swept_features, tool_motion
from learning_to_simulate.methods.tool_motion import TravelFrame
from learning_to_simulate.scene import RigidMotion, Scene

SETS = ('path', 'swept', 'bed')
# Half the thickness of the blade of the scenes; only how far its cut reaches past it hangs on it.
EDGE_RADIUS = 0.014
PROFILE_BINS = 15


@dataclasses.dataclass(frozen=True)
class PathInputs:
    """Reads the inputs of a scene's runs.

    Attributes:
      scene: what exists.
      frame: the way of travel, of the training runs.
      surface: height of the resting bed, m.
      reach: [2] smallest and largest travel of the training runs from their start, m; the profile
        of `swept` is spread over it.
      places: [2] smallest and largest place along the way of the training runs, m; of `bed`.
      grid: bins of the swept profile.
    """

    scene: Scene
    frame: TravelFrame
    surface: float
    reach: tuple[float, float]
    places: tuple[float, float]
    grid: swept_features.SweptGrid

    @classmethod
    def of(cls, groups, scene: Scene, surface=None) -> 'PathInputs':
        """The reader for training groups; see `PathRidge.fit`."""
        bodies = [g.position[:, :, : g.n_rigid] for g in groups]
        frame = max(
            (TravelFrame.of(b, scene.up_axis) for b in bodies),
            key=lambda f: sum(f == TravelFrame.of(b, scene.up_axis) for b in bodies),
        )
        u = [frame.plane(b).mean(axis=2)[..., 0] for b in bodies]
        travel = np.concatenate([(x - x[:, :1]).reshape(-1) for x in u])
        if surface is None:
            surface = float(np.mean([b[:, 0, :, scene.up_axis].min() for b in bodies]))
        span = max(float(np.ptp(travel)), 10 * EDGE_RADIUS)
        # Runs to come may go farther than those of training did, by half of their span.
        grid = swept_features.SweptGrid(
            radius=EDGE_RADIUS,
            behind=float(-travel.min()) + span / 2 + 0.2,
            ahead=float(travel.max()) + span / 2 + 0.2,
        )
        reach = (float(travel.min()), float(travel.max()))
        places = (min(float(x.min()) for x in u), max(float(x.max()) for x in u))
        return cls(scene, frame, float(surface), reach, places, grid)

    @property
    def sets(self) -> tuple[str, ...]:
        """Names of the sets of inputs that the scene has."""
        return SETS if self.scene.rigid_motion == RigidMotion.PRESCRIBED else SETS[:1]

    def read(self, group, name: str) -> np.ndarray:
        """Inputs [S, T, I] of the runs of a group.

        Raises:
          ValueError: a path that leaves the bins.
        """
        body = group.position[:, :, : group.n_rigid]
        if self.scene.rigid_motion == RigidMotion.PRESCRIBED:
            parts = self._blade(body, name)
        else:
            hidden = tool_motion.hidden_height(body, self.scene, H)
            parts = [self._wheel(hidden)]
        if group.context is not None:
            by_frame = group.context if group.context.ndim == 3 else group.context[:, None]
            shape = (*body.shape[:2], by_frame.shape[-1])
            parts.append(np.broadcast_to(_context(by_frame), shape))
        return np.concatenate(parts, axis=-1)

    def _blade(self, body, name):
        tip, lean = tool_motion.blade_pose(body, self.frame)
        dt, n_frame = self.scene.dt, body.shape[1]
        state = swept_features.start(self.grid, tip[:, 0], self.surface)
        begun = tip[:, :1, 0]
        if name == 'bed':
            places = np.broadcast_to(
                np.linspace(*self.places, PROFILE_BINS), (len(tip), PROFILE_BINS)
            )
        else:
            places = begun + np.linspace(*self.reach, PROFILE_BINS)
        path, profile = [], []
        lowest = tip[:, 0, 1]
        for t in range(n_frame):
            if t:
                state = swept_features.advance(self.grid, state, tip[:, t], dt)
            lowest = np.minimum(lowest, tip[:, t, 1])
            path.append(
                [
                    tip[:, t, 0] - tip[:, 0, 0],
                    tip[:, t, 1] - self.surface,
                    lean[:, t],
                    lowest - self.surface,
                    state.foremost - tip[:, t, 0],
                    swept_features.swept_area(self.grid, state),
                    *state.velocity.T,
                    np.hypot(*state.velocity.T),
                ]
            )
            cut = swept_features.profile_at(self.grid, state, places) - self.surface
            profile.append(cut)
        parts = [np.moveaxis(np.array(path), 2, 0)]
        if name != 'path':
            parts.append(np.stack(profile, axis=1))
        if name == 'bed':
            parts.append(np.broadcast_to(begun[:, None], (len(tip), n_frame, 1)))
        return parts

    def _wheel(self, body):
        centre, turned, radius, width = tool_motion.wheel_pose(body, self.frame)
        dt = self.scene.dt
        travel = centre[..., 0] - centre[:, :1, 0]
        rolled = radius[:, None] * turned
        speed, spin = (np.diff(x, axis=1, prepend=x[:, :1]) / dt for x in (travel, rolled))
        slid = np.cumsum(np.abs(spin - speed), axis=1) * dt
        rows = [travel, rolled, rolled - travel, np.maximum.accumulate(travel, axis=1), slid]
        rows += [speed, spin]
        start = np.broadcast_to(centre[:, H - 1, 1] - self.surface, (1, len(body)))
        size = np.stack([np.log(radius), np.log(width), (start[0] - radius)], axis=1)
        return np.concatenate(
            [np.stack(rows, axis=-1), np.repeat(size[:, None], body.shape[1], axis=1)], axis=-1
        )

    def to_json(self) -> dict:
        """Values of `from_json`."""
        return {
            'frame': dataclasses.asdict(self.frame),
            'surface': self.surface,
            'reach': list(self.reach),
            'places': list(self.places),
            'grid': dataclasses.asdict(self.grid),
        }

    @classmethod
    def from_json(cls, values: dict, scene: Scene) -> 'PathInputs':
        """Rebuilds the reader; raises KeyError, TypeError or ValueError on foreign values."""
        return cls(
            scene,
            TravelFrame(**values['frame']),
            float(values['surface']),
            tuple(map(float, values['reach'])),
            tuple(map(float, values['places'])),
            swept_features.SweptGrid(**values['grid']),
        )


def _context(context):
    """Context [..., C], as logarithms where it is positive: loads and gravities span decades."""
    positive = context > 0
    return np.where(positive, np.log(np.where(positive, context, 1.0)), context)
