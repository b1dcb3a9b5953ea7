"""Runs of a dataset as episodes: a bed, a tool's path over it, and what soil and tool did.

An episode may begin in the middle of a run, on the bed as it then is. Beds are read from all
particles that the modes of the first frame decode to: an episode knows nothing of later frames.
"""

import dataclasses

import numpy as np

from learning_to_simulate.methods import resting_bed
from learning_to_simulate.methods.swept_field.axes import Axes
from learning_to_simulate.methods.swept_field.tool_path import Bed, Frame
from learning_to_simulate.methods.swept_field.tools import Tool
from learning_to_simulate.methods.tool_motion import TravelFrame
from pca_tools import dataset, particles
from pca_tools.splits import spread_over
from pca_tools.subspace import Subspace


@dataclasses.dataclass
class Episode:
    """One run from one of its frames on; T frames, F of them with P particles.

    Attributes:
      record: of the run.
      start: first frame.
      pose: float64 [T, K] and size: float64 [S] of the tool, see `tools`.
      surface: float64 [n] of the bed at the grid's offsets from the first place, m.
      level, end: see `tool_path.Bed`.
      frames: int [F], numbers of the frames with particles, from the start.
      rest: float64 [P, 3] u, height, distance from the middle plane in the first frame, m.
      moved: float32 [F, P, 3] displacement since, along, up, across, m.
      load: float32 [T, 3], see `Axes.loads`.
    """

    record: int
    start: int
    pose: np.ndarray
    size: np.ndarray
    surface: np.ndarray
    level: float
    end: float
    frames: np.ndarray
    rest: np.ndarray
    moved: np.ndarray
    load: np.ndarray

    @property
    def bed(self) -> Bed:
        """The bed of one tool."""
        return Bed(self.surface[None], np.array([self.level]), np.array([self.end]))

    @property
    def local_rest(self) -> np.ndarray:
        """float32 [P, 3]: `rest` from the tool's first place and the level."""
        return (self.rest - [self.pose[0, 0], self.level, 0.0]).astype(np.float32)


class BedReader:
    """Beds from particles.

    Args:
      axes: of the scene.
      grid: bins along the way.
      kept_spacing: between given particles, m.
      spacing: between those of the solver, m.
    """

    def __init__(self, axes: Axes, grid, kept_spacing: float, spacing: float):
        self.axes, self.grid = axes, grid
        self.kept_spacing, self.spacing = kept_spacing, spacing

    def read(self, points, u: float, width: float) -> tuple[np.ndarray, float, float]:
        """Surface [n], level and end (m) of particles [N, 3] for a tool at u.

        Raises:
          ValueError: no particle lies where the blade passes.
        """
        surface = resting_bed.surface_profile(
            points,
            u + self.grid.offsets,
            self.axes.frame,
            self.kept_spacing,
            self.spacing,
            half_width=width / 2,
        )
        along = self.axes.frame.plane(points)[:, 0]
        there = (u + self.grid.offsets >= along.min()) & (u + self.grid.offsets <= along.max())
        level = float(np.median(surface[there] if there.any() else surface))
        return surface, level, float(along.max() + self.spacing / 2)


def find_axes(runs, up: int) -> Axes:
    """The axes of runs: where most of their tools drive, and the middle of those.

    Raises:
      ValueError: a run without the pose of its body.
    """
    frames = []
    for i, run in enumerate(runs):
        if run.rigid_pose is None or not run.n_rigid:
            raise ValueError(
                f'record {i} holds no pose of a rigid body, from which a swept field learns; '
                f'convert runs that have one'
            )
        frames.append(TravelFrame.of(run.rigid_pose[None, :, None, :3].astype(np.float64), up))
    frame = max(frames, key=frames.count)
    across = 3 - frame.axis - up
    middle = float(np.mean([run.rigid_pose[:, across].mean() for run in runs]))
    return Axes(frame.axis, frame.sign, frame.up, middle)


class EpisodeReader:
    """Reads the episodes of a dataset.

    Args:
      folder: of the dataset.
      metadata: of it.
      beds: reads the beds.
      tool: of the field.

    Raises:
      FileNotFoundError: no subspace.
    """

    def __init__(self, folder: str, metadata: dict, beds: BedReader, tool: Tool):
        self._folder, self._metadata, self._beds = folder, metadata, beds
        self._tool = tool
        self._names = metadata.get('scene', {}).get('context_names', ())
        self.subspace = Subspace.load(f'{folder}/subspace.npz')

    def _case(self, split, record):
        cases = self._metadata.get('cases', {}).get(split, [])
        return cases[record] if record < len(cases) else {}

    def points(self, run, frame: int) -> np.ndarray:
        """float64 [N, 3], m: all particles of a frame, from its modes."""
        return self.subspace.decode(run.position[frame : frame + 1, run.n_rigid :])[0].astype(float)

    def sample(self, split: str) -> particles.ParticleSample:
        """The particles that the dataset keeps of a split."""
        return particles.read_sample(self._folder, split)

    def read(self, split: str, start_every: int = 0, limit: int = 0) -> list[Episode]:
        """The episodes of a split.

        Args:
          split: of the dataset.
          start_every: frames between starts in the middle of runs; 0: none there.
          limit: only of so many runs, spread over the split; 0: of all.
        """
        sample = self.sample(split)
        found = []
        runs = dataset.read_split(self._folder, split)
        for record in spread_over(len(runs), limit):
            run = runs[record]
            positions = sample[record]
            starts = [0]
            if start_every:
                # Further starts fall on frames with particles, elsewhere in every run.
                stride = sample.frame_stride
                first = stride * (1 + (record * 7919) % (start_every // stride))
                starts += list(range(first, run.n_frames - start_every // 2, start_every))
            for begin in starts:
                found.append(self._episode(split, record, run, sample, positions, begin))
        return found

    def _episode(self, split, record, run, sample, positions, begin):
        axes, stride = self._beds.axes, sample.frame_stride
        context = None
        if run.step_context is not None:
            context = dict(zip(self._names, run.step_context[begin:].astype(np.float64).T))
        pose = self._tool.poses(axes, run.rigid_pose[begin:], context)
        first = None if context is None else {k: v[0] for k, v in context.items()}
        body = run.position[0, : run.n_rigid]
        size = self._tool.size(axes, self._case(split, record), body, first)
        width = self._tool.width_of(size)
        surface, level, end = self._beds.read(self.points(run, begin), pose[0, 0], width)
        places = axes.points(positions[begin // stride :])
        return Episode(
            record=record,
            start=begin,
            pose=pose,
            size=size,
            surface=surface,
            level=level,
            end=end,
            frames=stride * np.arange(len(places)),
            rest=places[0],
            moved=(places - places[0]).astype(np.float32),
            load=axes.loads(
                run.force[begin:], None if run.torque is None else run.torque[begin:]
            ).astype(np.float32),
        )


def frames_of(episodes, tool: Tool, grid, dt: float) -> list[Frame]:
    """`Frame` of [T, ...] of each episode, along its recorded poses; those of equal length go
    together."""
    found: list = [None] * len(episodes)
    by_length: dict[int, list[int]] = {}
    for i, episode in enumerate(episodes):
        by_length.setdefault(len(episode.pose), []).append(i)
    for members in by_length.values():
        chosen = [episodes[i] for i in members]
        bed = Bed(*map(np.stack, zip(*((e.surface, e.level, e.end) for e in chosen))))
        pose = np.stack([e.pose for e in chosen], axis=1)
        _, frames = tool.frames(grid, bed, np.stack([e.size for e in chosen]), pose, dt)
        for k, i in enumerate(members):
            found[i] = Frame(frames.bins[:, k], frames.scalars[:, k])
    return found
