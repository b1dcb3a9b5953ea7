"""Runs of a dataset as episodes: a bed, a tool's path over it, and what soil and tool did.

An episode may begin in the middle of a run, on the bed as it then is. Beds are read from all
particles that the modes of the first frame decode to: an episode knows nothing of later frames.
"""

import dataclasses

import numpy as np

from learning_to_simulate.tool.bed import Ground
from learning_to_simulate.tool.swept import Bed, Frame
from learning_to_simulate.tool.tool import Tool
from pca_tools import dataset, particles
from pca_tools.splits import spread_over
from pca_tools.subspace import Subspace


@dataclasses.dataclass
class Episode:
    """One run from one of its frames on; T frames, F of them with P particles.

    Attributes:
      record: of the run.
      start: first frame.
      pose: float64 [T, K] of the tool, see `tool.tool`.
      path: float64 [T, 7], the same poses in the world.
      ground: what it begins on, of the P particles.
      frames: int [F], numbers of the frames with particles, from the start.
      moved: float32 [F, P, 3] displacement since, along, up, across, m.
      load: float32 [T, 3], see `Axes.loads`.
    """

    record: int
    start: int
    pose: np.ndarray
    path: np.ndarray
    ground: Ground
    frames: np.ndarray
    moved: np.ndarray
    load: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """[S] of the tool."""
        return self.ground.size


class EpisodeReader:
    """Reads the episodes of a dataset.

    Args:
      folder: of the dataset.
      metadata: of it.
      field: `field.SweptField`, whose tool goes and which reads the beds.

    Raises:
      FileNotFoundError: no subspace.
    """

    def __init__(self, folder: str, metadata: dict, field):
        self._folder, self._metadata, self._field = folder, metadata, field
        self._names = metadata.get('scene', {}).get('context_names', ())
        self.subspace = Subspace.load(f'{folder}/subspace.npz')

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
          limit: number of runs, spread over the split; 0: all.
        """
        sample = self.sample(split)
        cases = self._metadata.get('cases', {}).get(split, [])
        found = []
        runs = dataset.read_split(self._folder, split)
        for record in spread_over(len(runs), limit):
            run = runs[record]
            case = cases[record] if record < len(cases) else {}
            starts = [0]
            if start_every:
                # Further starts fall on frames with particles, elsewhere in every run.
                stride = sample.frame_stride
                first = stride * (1 + (record * 7919) % (start_every // stride))
                starts += list(range(first, run.n_frames - start_every // 2, start_every))
            positions = sample[record]
            for begin in starts:
                found.append(
                    self._episode(record, run, case, sample.frame_stride, positions, begin)
                )
        return found

    def _episode(self, record, run, case, stride, positions, begin):
        axes, tool = self._field.axes, self._field.tool
        context = None
        if run.step_context is not None:
            context = dict(zip(self._names, run.step_context[begin:].astype(np.float64).T))
        pose = tool.poses(axes, run.rigid_pose[begin:], context)
        first = None if context is None else {k: v[0] for k, v in context.items()}
        size = tool.size(axes, case, run.position[0, : run.n_rigid], first)
        ground = self._field.ground(pose[0, 0], size, self.points(run, begin))
        sampled = positions[begin // stride :]
        places = axes.points(sampled)
        return Episode(
            record=record,
            start=begin,
            pose=pose,
            path=run.rigid_pose[begin:].astype(np.float64),
            ground=ground._replace(points=sampled[0], places=places[0]),
            frames=stride * np.arange(len(places)),
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
        bed = Bed(*map(np.concatenate, zip(*(e.ground.bed for e in chosen))))
        pose = np.stack([e.pose for e in chosen], axis=1)
        _, frames = tool.frames(grid, bed, np.stack([e.size for e in chosen]), pose, dt)
        for k, i in enumerate(members):
            found[i] = Frame(frames.bins[:, k], frames.scalars[:, k])
    return found
