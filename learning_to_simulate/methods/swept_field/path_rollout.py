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
from learning_to_simulate.methods.swept_field import beds, quality
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
        """The start of a path, its poses, whether it begins on the bed of a case, and its context
        [T, C] or None; as `live.path_rollout.PathRoller.beginning`. Raises for contexts as
        `SweptField.check_contexts`."""
        values = poses.numbers('path', path, (None, 7), (None, 3))
        if len(values) < 2:
            raise ValueError(f'a path of {len(values)} poses has no step, at least two are needed')
        scene, contexts = self._field.scene, None
        if np.ndim(context) == 2 and scene.context_names:
            shape = (len(values), len(scene.context_names))
            contexts = poses.numbers('context', context, shape)
            context = contexts[0]
        chosen = Beginning(scene, self._starts, scene.n_modes)
        chosen.choose(case=case, context=context)
        values = np.stack([chosen.read(pose) for pose in values])
        if velocity is None:
            velocity = velocity_between(values[0], values[1], scene.dt)
        chosen.choose(values[0], velocity, case, context)
        if contexts is None and chosen.context is not None:
            contexts = np.repeat(chosen.context[None], len(values), axis=0)
        if contexts is not None:
            self._field.check_contexts(contexts)
        return chosen, values, case is not None, contexts

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
        pose, frames = field.frames(episode.bed, episode.size, episode.pose, field.scene.dt)
        points = evaluator.bed(group)
        origin = np.array([episode.pose[0, 0], episode.level, 0.0])
        ground = Ground(points, field.axes.points(points), origin, episode.size)
        swept = _one_by_one(frames, pose, ground, H)
        return dataclasses.replace(found, modes=SweptFrames(swept, self._soil))

    def _rolled(self, chosen, path, is_given, contexts) -> SoilRollout:
        field, case = self._field, self._starts.cases[chosen.index]
        named = field.context(contexts)
        first = None if named is None else {name: values[0] for name, values in named.items()}
        size = field.tool.size(field.axes, case, chosen.nodes(chosen.pose), first)
        plane = field.tool.poses(field.axes, path, named)
        recorded = None
        if is_given or field.tool.predicts_height:
            recorded = self._space, self._starts.modes[chosen.index]
        ground, swept_bed = beds.ground(field, plane[0], size, recorded=recorded)
        start = field.tool.velocity(field.axes, chosen.velocity, size)
        plane, frames = field.frames(swept_bed, size, plane, field.scene.dt, start)
        path = path.copy()
        path[:, field.axes.up] = plane[:, 1]
        loads = field.loads(frames).mean(axis=0)
        force, torque = field.axes.world_loads(loads[:, :3])
        names, finite = field.tool.scalars, np.isfinite(loads).all(axis=1)
        statuses = quality.statuses(frames.scalars, field.ranges, finite, names)
        swept = _one_by_one(frames, plane, ground, 1)
        body = np.stack([poses.placed(chosen.body, p) for p in [*chosen.past(), *path[1:]]])
        return SoilRollout(
            history=chosen.history(),
            modes=SweptFrames(swept, self._soil),
            force=force[1:].astype(np.float32),
            rigid_nodes=body[H:, chosen.kept],
            judgement=quality.judge(frames.scalars, field.ranges, H - 1, finite.all(), names),
            frame_status=tuple(statuses[1:]),
            body=body,
            scene=field.scene,
            soil=self._soil,
            torque=torque[1:].astype(np.float32),
        )


def _one_by_one(frames, plane, ground, first):
    """The frames from the first on as `Swept`."""
    return [
        Swept(Frame(frames.bins[t : t + 1], frames.scalars[t : t + 1]), plane[t], ground)
        for t in range(first, len(plane))
    ]
