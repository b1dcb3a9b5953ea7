"""Whole paths of a swept field at once: from poses to a rollout, as `live.path_rollout`.

No frame waits for another: all loads of a path come from one call, and particles of a frame are
computed when they are asked for.
"""

import dataclasses

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import poses, resting_start
from learning_to_simulate.live.live_soil import Beginning
from learning_to_simulate.live.path_rollout import SoilRollout, of_recorded_run, velocity_between
from learning_to_simulate.live.stepping import FLAG
from learning_to_simulate.methods.swept_field import beds, episodes, quality, tool_path
from learning_to_simulate.methods.swept_field.field_soil import (
    FieldSoil,
    Ground,
    Swept,
    SweptFrames,
)
from learning_to_simulate.methods.swept_field.live import LiveField
from learning_to_simulate.methods.swept_field.tool_path import Frame


def stepper(path: str, model, outside: str = FLAG) -> LiveField:
    """A `LiveField` of a model folder and the model that was loaded from it.

    Raises:
      FileNotFoundError, ValueError: as `resting_start.read`.
    """
    return LiveField(model.field, *resting_start.read(path), outside=outside)


def roller(path: str, model) -> 'FieldRoller':
    """A `FieldRoller` of a model folder; arguments as of `stepper`."""
    return FieldRoller(model.field, *resting_start.read(path))


class FieldRoller:
    """Rolls out paths.

    Args:
      field: `SweptField`.
      starts, subspace: of the model folder.
    """

    def __init__(self, field, starts, subspace=None):
        self._field, self._starts, self._space = field, starts, subspace
        self._soil = FieldSoil(field, subspace)

    def beginning(self, path, velocity=None, case=None, context=None):
        """The start of a path, its poses, and whether it begins on the bed of a case; as
        `live.path_rollout.PathRoller.beginning`."""
        values = poses.numbers('path', path, (None, 7), (None, 3))
        if len(values) < 2:
            raise ValueError(f'a path of {len(values)} poses has no step, at least two are needed')
        scene = self._field.scene
        chosen = Beginning(scene, self._starts, scene.n_modes)
        chosen.choose(case=case, context=context)
        values = np.stack([chosen.read(pose) for pose in values])
        if velocity is None:
            velocity = velocity_between(values[0], values[1], scene.dt)
        return chosen.choose(values[0], velocity, case, context), values, case is not None

    def roll_out(self, begun) -> list[SoilRollout]:
        """Rolls out paths of `beginning`.

        Raises:
          ValueError: a path that leaves the bins.
        """
        return [self._rolled(*one) for one in begun]

    def recorded(self, evaluator, group, name: str) -> SoilRollout:
        """The rollout of a recorded run, with its truth.

        Args:
          evaluator: `FieldEvaluator` of its split.
          group: one-run `RunGroup`.
          name: for files and titles.
        """
        field, rollout = self._field, evaluator.roll_out(group)
        found = of_recorded_run(group, rollout, field.scene, self._soil, name)
        episode = evaluator.episode(int(group.record[0]))
        (frames,) = episodes.frames_of([episode], field.grid, field.scene.dt)
        points = evaluator.bed(group)
        origin = np.array([episode.pose[0, 0], episode.level, 0.0])
        ground = Ground(points, field.axes.points(points), origin, episode.width)
        swept = _one_by_one(frames, episode.pose, ground, H)
        return dataclasses.replace(found, modes=SweptFrames(swept, self._soil))

    def _rolled(self, chosen, path, is_given) -> SoilRollout:
        field = self._field
        plane = field.axes.poses(path)
        recorded = (self._space, self._starts.modes[chosen.index]) if is_given else None
        ground, swept_bed = beds.ground(
            field, plane[0], case=self._starts.cases[chosen.index], recorded=recorded
        )
        start = field.axes.velocities(chosen.velocity)[None]
        frames = tool_path.frames(
            field.grid, swept_bed, np.array([ground.width]), plane[:, None], field.scene.dt, start
        )
        frames = Frame(frames.bins[:, 0], frames.scalars[:, 0])
        loads = field.loads(frames).mean(axis=0)
        force, _ = field.axes.world_loads(loads)
        statuses = quality.statuses(frames.scalars, field.ranges, np.isfinite(loads).all(axis=1))
        swept = _one_by_one(frames, plane, ground, 1)
        body = np.stack([poses.placed(chosen.body, p) for p in [*chosen.past(), *path[1:]]])
        return SoilRollout(
            history=chosen.history(),
            modes=SweptFrames(swept, self._soil),
            force=force[1:].astype(np.float32),
            rigid_nodes=body[H:, chosen.kept],
            judgement=quality.judge(frames.scalars, field.ranges, H - 1, np.isfinite(loads).all()),
            frame_status=tuple(statuses[1:]),
            body=body,
            scene=field.scene,
            soil=self._soil,
        )


def _one_by_one(frames, plane, ground, first):
    """The frames from the first on as `Swept`."""
    return [
        Swept(Frame(frames.bins[t : t + 1], frames.scalars[t : t + 1]), plane[t], ground)
        for t in range(first, len(plane))
    ]
