"""`TerrainRollout`: a whole way of a tool over a terrain, its loads, maps and particles."""

import dataclasses
import json
import time
from collections.abc import Callable

import numpy as np

from learning_to_simulate.rollout_status import OK, Judged, Judgement, RolloutStatus
from learning_to_simulate.soil_field.runs import Run
from learning_to_simulate.soil_field.stepper import DT, SoilFrame, SoilStepper
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Tool
from pca_tools import files

EVERY = 4  # frames between maps of heights
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 49)


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class TerrainRollout(Judged):
    """T frames of a tool on a terrain; in F of them, the first included, there is a map.

    Attributes:
      tool: what went.
      before: `Terrain` before it came.
      pose: float64 [T, 7].
      force, torque: float64 [T, 3] of the soil on the tool, N, N m (about the position of the
        pose), world.
      frames: int [F], frames of the maps.
      heights: float32 [F, nx, nz], m; what a bucket holds counts, see `SoilStepper.heights`.
      frame_status: T statuses of the frames alone.
      spread: float64 [T, 3], N, standard deviation of the force over members, see `SoilFrame`.
      bound: float64 [T], N, of the error of the force, see `SoilField.bound`.
      judgement: the worst, and where it is first.
      dt: s of a frame.
      seconds: that the computation took.
      payload: float64 [T], m3 of soil in a bucket, or None of a run that was refused.
      particles: float32 [F, P, 3], m, of a recorded run that has particles; else None.
      run: `runs.Run` that was followed, or None of a path that nobody recorded.
      name: for files.
    """

    tool: Tool
    before: Terrain
    pose: np.ndarray
    force: np.ndarray
    torque: np.ndarray
    frames: np.ndarray
    heights: np.ndarray
    frame_status: tuple[RolloutStatus, ...]
    spread: np.ndarray
    bound: np.ndarray
    judgement: Judgement = OK
    dt: float = DT
    seconds: float = 0.0
    payload: np.ndarray | None = None
    particles: np.ndarray | None = None
    run: Run | None = None
    name: str = 'rollout'

    def __len__(self) -> int:
        return len(self.pose)

    @property
    def time(self) -> np.ndarray:
        return self.dt * np.arange(len(self))

    @property
    def judgements(self) -> list[Judgement]:
        """As of `rollout.Rollout`."""
        return [self.judgement]

    def arrays(self) -> dict[str, np.ndarray]:
        """What a file of it holds; `rendering.terrain_views` draws that."""
        found = {
            'pose': self.pose,
            'predicted_forces': self.force,
            'predicted_torques': self.torque,
            'force_bound': self.bound,
            'flagged': np.array([s != RolloutStatus.OK for s in self.frame_status]),
            'height_frames': self.frames,
            'heights_before': self.before.heights.astype(np.float32),
            'predicted_heights': self.heights,
            'corner': self.before.corner,
            'cell': self.before.cell,
            'outline': outline(self.tool),
            'dt': np.array(self.dt),
            'tool': np.array(json.dumps({'name': self.tool.name} | dataclasses.asdict(self.tool))),
            'soil': np.array(json.dumps(dataclasses.asdict(self.before.soil))),
        }
        found |= {key: np.array(value) for key, value in self.judgement.fields().items()}
        if self.payload is not None:
            found['payload'] = self.payload
        if self.particles is not None:
            found['predicted_particles'] = self.particles
        if self.run is not None:
            run = self.run
            found |= {
                'case': np.array(run.case), 'kind': np.array(run.kind),
                'split': np.array(run.split), 'ground_truth_pose': run.pose,
                'ground_truth_forces': run.force, 'ground_truth_torques': run.torque,
                'ground_truth_heights': run.heights.astype(np.float32),
            }  # fmt: skip
            if run.particles is not None:
                found['ground_truth_particles'] = run.particles.astype(np.float32)
        return found

    def save(self, path: str) -> None:
        """Writes an `.npz` that `lts render` draws, whole or not at all."""
        files.write_npz(path, **self.arrays())

    def render(self, path: str, **options) -> None:
        """Draws the rollout into a file .png, .gif or .mp4; options of `terrain_views.draw`.
        ValueError: another ending, or a package for pictures is missing (pip install .[viz])."""
        from learning_to_simulate import render_rollout

        render_rollout.draw_terrain(self.arrays(), path, **options)


def outline(tool: Tool) -> np.ndarray:
    """Points [K, 2] (m, from the pose, along the way and up) about an upright tool: a wheel with
    one spoke, a blade as thick as its edge."""
    circle = tool.radius * np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)], axis=1)
    if tool.name == 'wheel':
        return np.concatenate([[[0.0, 0.0]], circle])
    below = circle[len(circle) // 2 :]
    top = tool.length - tool.radius  # type: ignore[attr-defined]
    return np.concatenate([below, [[tool.radius, top], [-tool.radius, top]], below[:1]])


def roll_out(
    stepper: SoilStepper, path, dt: float = DT, every: int = EVERY,
    step: Callable[[int], SoilFrame] | None = None, particles=None, **more,
) -> TerrainRollout:  # fmt: skip
    """Sets a tool down on the terrain of a stepper and goes along a path.

    Args:
      stepper: is left at the end of the path.
      path: [T, 7] poses, one a frame.
      dt: s of a frame.
      every: frames from one map to the next.
      step: goes to a frame of a number, where the tool does not follow the path itself; None: to
        the next pose.
      particles: [P, 3], m, to be followed from before the tool is set down; or None.
      **more: `run` and `name` of the rollout.

    Raises:
      ValueError: no path; as `SoilStepper.start` and `step`.
    """
    path = np.asarray(path, np.float64)
    if path.ndim != 2 or path.shape[1] != 7 or len(path) < 1:
        raise ValueError(f'a path has shape {path.shape}, [T, 7] poses were expected')
    clock, terrain = time.perf_counter(), stepper.terrain
    before = terrain.clone()
    if step is None:

        def step(t):
            return stepper.step(path[t], dt)

    frames, heights, followed = [], [], []
    for t in range(len(path)):
        frames.append(step(t) if t else stepper.start(path[0], particles))
        if not t % every:
            heights.append(stepper.heights.astype(np.float32))
            if particles is not None:
                followed.append(stepper.particles())
    return TerrainRollout(
        tool=stepper.tool,
        before=before,
        pose=np.stack([frame.pose for frame in frames]),
        force=np.stack([frame.force for frame in frames]),
        torque=np.stack([frame.torque for frame in frames]),
        frames=np.arange(0, len(path), every),
        heights=np.stack(heights),
        frame_status=tuple(frame.now.status for frame in frames),
        spread=np.stack([frame.spread[:3] for frame in frames]),
        bound=np.array([frame.bound for frame in frames]),
        judgement=frames[-1].judgement,
        dt=dt,
        seconds=time.perf_counter() - clock,
        payload=np.array([frame.payload for frame in frames]),
        particles=np.stack(followed) if followed else None,
        **more,
    )
