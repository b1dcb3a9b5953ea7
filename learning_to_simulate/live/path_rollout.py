"""Whole paths at once: from poses to a rollout that can be looked at, saved and drawn."""

import dataclasses
import functools
import json

import numpy as np
from scipy.spatial.transform import Rotation

from learning_to_simulate import loads, reading_utils
from learning_to_simulate.compiled.folded_step import rollout_function
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.evaluation import soil_of_run, torque_of, total_force
from learning_to_simulate.live import poses
from learning_to_simulate.live.frame_judge import FrameJudge, worse
from learning_to_simulate.live.live_soil import Beginning
from learning_to_simulate.live.soil import Soil
from learning_to_simulate.reading_utils import RunGroup
from learning_to_simulate.rollout import rollout_inputs
from learning_to_simulate.rollout_status import Judgement, RolloutStatus
from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.soil_truth import PARTICLES, SoilTruth
from pca_tools import dataset, files

# Paths are padded to a multiple of so many frames, so that few lengths are compiled.
FRAME_BLOCK = 64


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class SoilRollout:
    """A predicted run of T' frames after H given ones.

    Attributes:
      history: float64 [H, V, 3], m: the given frames; R nodes of the body, then r modes.
      modes: float64 [T', r, 3] scores, m.
      force: float32 [T', 3], N, or None.
      rigid_nodes: float64 [T', R, 3], m: the nodes of the body.
      judgement: the worst status, with the first frame in which it holds and the reason.
      frame_status: T' statuses: of each frame of a path alone; of a recorded run, from the first
        bad frame on.
      body: float64 [H + T', R', 3], m: all particles of the body.
      scene: `Scene`.
      soil: turns modes into particles; None without a subspace.
      truth: (modes [H + T', r, 3], body [H + T', R', 3], force [H + T', 3] or None) of a recorded
        run; None of a path.
      name: for files and titles.
      torque: float32 [T', 3] about the body's reference point, N m, where the model predicts one.
      true_torque: float64 [H + T', 3] of a recorded run, where there is a `torque`; else None.
      soil_truth: `soil_truth.SoilTruth` of a recorded run, else None.
      sampled: float64 [F, P, 3], m: the predicted particles that it is compared with.
    """

    history: np.ndarray
    modes: np.ndarray
    force: np.ndarray | None
    rigid_nodes: np.ndarray
    judgement: Judgement
    frame_status: tuple[RolloutStatus, ...]
    body: np.ndarray
    scene: Scene
    soil: Soil | None
    truth: tuple | None = None
    name: str = 'rollout'
    torque: np.ndarray | None = None
    true_torque: np.ndarray | None = None
    soil_truth: SoilTruth | None = None
    sampled: np.ndarray | None = None

    def __repr__(self) -> str:
        reason = f' ({self.reason})' if self.reason else ''
        return f'<rollout {self.name!r}: {len(self.modes)} frames, {self.status}{reason}>'

    @property
    def status(self) -> RolloutStatus:
        """How far the rollout can be trusted."""
        return self.judgement.status

    @property
    def reason(self) -> str:
        """Value and limits behind the status, in words; '' where it is OK."""
        return self.judgement.reason

    @property
    def soil_mm(self) -> float | None:
        """The error of soil of a recorded run, mm (see `soil_truth`); None of a path."""
        return None if self.soil_truth is None else self.soil_truth.soil_mm(self.sampled)

    @property
    def time(self) -> np.ndarray:
        """float64 [T'], s after the start."""
        return self.scene.dt * np.arange(1, len(self.modes) + 1)

    def particles(self, frame: int | None = None) -> np.ndarray:
        """float32 [N, 3] of a frame, or [T', N, 3] of all, m.

        Raises:
          ValueError: without a subspace.
        """
        if self.soil is None:
            raise ValueError('particles need a subspace: the model has none')
        return self.soil.particles(self.modes if frame is None else self.modes[frame])

    def height_map(self, nx: int, nz: int, frame: int = -1) -> np.ndarray:
        """float32 [nx, nz] heights of the surface in a frame, m; see `Soil.height_map`.

        Raises:
          ValueError: without a subspace.
        """
        if self.soil is None:
            raise ValueError('a height map needs a subspace: the model has none')
        return self.soil.height_map(self.modes[frame], nx, nz)

    def save(self, path: str) -> None:
        """Writes an `.npz` that `render_rollout` reads, whole or not at all; DeepMind's key names.

        Raises:
          OSError: it cannot be written.
        """
        n_rigid = self.body.shape[1]
        kind = (
            dataset.KINEMATIC_PARTICLE_ID
            if self.scene.rigid_motion == RigidMotion.PRESCRIBED
            else dataset.RIGID_PARTICLE_ID
        )
        modes = np.concatenate([self.history[:, self.history.shape[1] - self.scene.n_modes :],
                                self.modes])  # fmt: skip
        nodes = np.concatenate([self.body, modes], axis=1).astype(np.float32)
        types = [kind] * n_rigid + [dataset.MODE_PARTICLE_ID] * self.scene.n_modes
        arrays = {
            'initial_positions': nodes[:H],
            'predicted_rollout': nodes[H:],
            'particle_types': np.array(types),
            'scene': np.array(json.dumps(self.scene.to_json())),
            'status': np.array(str(self.status)),
            'first_bad_frame': np.array(self.judgement.frame),
            'first_bad_node': np.array(self.judgement.node),
            'status_reason': np.array(self.reason),
        }
        if self.force is not None:
            arrays['predicted_forces'] = self.force
        if self.torque is not None:
            arrays['predicted_torques'] = self.torque
        if self.true_torque is not None:
            arrays['initial_torques'] = self.true_torque[:H].astype(np.float32)
            arrays['ground_truth_torques'] = self.true_torque[H:].astype(np.float32)
        if self.soil_truth is not None and self.soil_truth.space == PARTICLES:
            arrays['predicted_particles'] = self.sampled.astype(np.float32)
            arrays['particle_frames'] = self.soil_truth.frames
            arrays['particle_indices'] = self.soil_truth.indices
        if self.truth is not None:
            true_modes, true_body, true_force = self.truth
            arrays['ground_truth_rollout'] = np.concatenate(
                [true_body, true_modes], axis=1, dtype=np.float32, casting='same_kind'
            )[H:]
            if true_force is not None:
                arrays['initial_forces'] = true_force[:H].astype(np.float32)
                arrays['ground_truth_forces'] = true_force[H:].astype(np.float32)
        files.write_npz(path, **arrays)

    def render(self, path: str, **options) -> None:
        """Draws the rollout; the ending of the path (.png, .gif, .mp4) decides how.

        Args:
          path: file to write.
          **options: `step_stride`, `color_by` and `plane` of `render_rollout.render`.

        Raises:
          ValueError: another ending, or a package for pictures is missing (pip install .[viz]).
        """
        from learning_to_simulate import render_rollout

        render_rollout.draw(self, path, **options)


class PathRoller:
    """Rolls out paths of one model; compiled once per body size, number of paths and block of
    lengths.

    Args:
      model: `subspace_model.Model`.
      starts: of the model folder.
      soil: of the model's subspace, or None.
    """

    def __init__(self, model, starts, soil: Soil | None):
        self._model, self._starts, self._soil = model, starts, soil
        self._scene = model.simulator.scene
        # Reading weights anew in every call, a function serves all lengths and batches.
        self._functions = functools.cache(
            lambda n_rigid: rollout_function(model.simulator, model.layout(n_rigid))
        )

    def beginning(self, path, velocity=None, case=None, context=None):
        """The start of a path and its poses.

        Args:
          path: [T, 7] or [T, 3] poses (see `poses`), T >= 2.
          velocity: at its beginning; None for that of its first two poses.
          case: as `LiveSoil.start`.
          context: likewise, or [T, C] where it changes in time.

        Returns:
          `Beginning`, float64 [T, 7], and the context [T, C] or None where it is that of the start.

        Raises:
          ValueError: not such a path.
        """
        values = poses.numbers('path', path, (None, 7), (None, 3))
        if len(values) < 2:
            raise ValueError(f'a path of {len(values)} poses has no step, at least two are needed')
        contexts = None
        if np.ndim(context) == 2 and self._scene.context_names:
            shape = (len(values), len(self._scene.context_names))
            contexts = poses.numbers('context', context, shape)
            context = contexts[0]
        chosen = Beginning(self._scene, self._starts, self._scene.n_modes)
        chosen.choose(case=case, context=context)
        values = np.stack([chosen.read(pose) for pose in values])
        if velocity is None:
            velocity = velocity_between(values[0], values[1], self._scene.dt)
        return chosen.choose(values[0], velocity, case, context), values, contexts

    def roll_out(self, begun) -> list[SoilRollout]:
        """Rolls out paths as one batch, those of equal bodies at a time.

        Args:
          begun: of `beginning`.
        """
        results: list = [None] * len(begun)
        sizes = [len(chosen.kept) for chosen, *_ in begun]
        for n_rigid in sorted(set(sizes)):
            mine = [i for i, size in enumerate(sizes) if size == n_rigid]
            for i, result in zip(mine, self._batch(n_rigid, [begun[i] for i in mine])):
                results[i] = result
        return results

    def _batch(self, n_rigid, begun):
        longest = max(len(path) for _, path, _ in begun) - 1
        n_frame = -(-longest // FRAME_BLOCK) * FRAME_BLOCK
        position = np.zeros((len(begun), H + n_frame, n_rigid + self._scene.n_modes, 3))
        for row, (chosen, path, _) in zip(position, begun):
            row[:H] = chosen.history()
            row[H:, :n_rigid] = chosen.nodes(path[-1])  # a body that has arrived stays
            row[H : H + len(path) - 1, :n_rigid] = [chosen.nodes(pose) for pose in path[1:]]
        contexts = None
        if self._scene.context_names:
            contexts = np.stack([chosen.context for chosen, *_ in begun])
            if any(by_frame is not None for *_, by_frame in begun):
                contexts = np.repeat(contexts[:, None], H + n_frame, axis=1)
            for row, (*_, by_frame) in zip(contexts, begun):
                if by_frame is not None:
                    row[H:] = by_frame[-1]
                    row[H : H + len(by_frame) - 1] = by_frame[1:]
        group = RunGroup(n_rigid, np.zeros(0, int), position, None, contexts, np.zeros(0, int))
        function = self._functions(n_rigid)
        offsets, load = function(*rollout_inputs(group, function.layout, self._scene))
        predicted = np.moveaxis(offsets.numpy(), 0, 1).astype(np.float64) + function.layout.origin
        load = None if load is None else np.moveaxis(load.numpy(), 0, 1)
        statistics = self._model.simulator.statistics
        judge = FrameJudge(n_rigid, statistics, self._scene, self._starts.force_limit)
        for s, (chosen, path, by_frame) in enumerate(begun):
            count = len(path) - 1
            of_path = loads.split(None if load is None else load[s, :count], statistics)
            yield self._result(
                judge, chosen, path, by_frame, position[s], predicted[s, :count], *of_path
            )

    def _result(self, judge, chosen, path, by_frame, given, predicted, force, torque):
        n, count = len(chosen.kept), len(predicted)
        judgement, statuses = chosen.judged(judge), []
        for k in range(count):
            of_frame = (None if load is None else load[k] for load in (force, torque))
            now = judge.predicted(H + k, predicted[k], *of_frame)
            outside = judge.given(H + k, given[H + k, :n], given[H + k - 1, :n])
            if by_frame is not None:
                outside = outside or judge.context(H + k, by_frame[k + 1])
            now = worse(now, outside or now)
            judgement = worse(judgement, now)
            statuses.append(now.status)
        nodes = np.concatenate([given[:H, :n], predicted[:, :n]])
        known = self._scene.rigid_motion.is_known
        path = np.concatenate([chosen.past(), path[1:]]) if known else None
        return SoilRollout(
            history=given[:H],
            modes=predicted[:, n:],
            force=force,
            rigid_nodes=predicted[:, :n],
            judgement=judgement,
            frame_status=tuple(statuses),
            body=whole_body(chosen, path, nodes, self._scene),
            scene=self._scene,
            soil=self._soil,
            torque=torque,
        )


def of_recorded_run(group, rollout, scene, soil: Soil | None, name: str) -> SoilRollout:
    """The rollout of a recorded run, with its truth.

    Args:
      group: one-run `RunGroup`.
      rollout: its `rollout.Rollout`.
      scene: of the model.
      soil: of the model's subspace, or None.
      name: for files and titles.
    """
    n = group.n_rigid
    (judgement,) = rollout.judgements
    history = group.position[0, :H]
    true = group.all_particles(group.position, as_recorded=True)[0]
    predicted = group.all_particles(np.concatenate([history[None], rollout.position], axis=1))[0]
    n_body = true.shape[1] - scene.n_modes - group.n_left_modes
    modes = slice(n_body, n_body + scene.n_modes)
    torque = torque_of(rollout)
    soil_truth, sampled = soil_of_run(group, rollout, scene)
    bad = np.arange(H, len(true)) >= (judgement.frame if judgement.frame >= 0 else len(true))
    return SoilRollout(
        history=history,
        modes=rollout.position[0, :, n:],
        force=None if rollout.force is None else total_force(rollout.force[0]),
        rigid_nodes=rollout.position[0, :, :n],
        judgement=judgement,
        frame_status=tuple(judgement.status if x else RolloutStatus.OK for x in bad),
        body=predicted[:, :n_body],
        scene=scene,
        soil=soil,
        truth=(
            true[:, modes],
            true[:, :n_body],
            None if group.force is None else total_force(group.force[0]),
        ),
        name=name,
        torque=torque,
        true_torque=None if torque is None or group.torque is None else group.torque[0],
        soil_truth=soil_truth,
        sampled=sampled,
    )


def velocity_between(first, second, seconds: float) -> np.ndarray:
    """Linear and angular velocity [6] that lead from a pose [7] to another one in some time."""
    turns = [Rotation.from_quat(np.roll(pose[3:], -1)) for pose in (first, second)]
    angular = (turns[1] * turns[0].inv()).as_rotvec()
    return np.concatenate([second[:3] - first[:3], angular]) / seconds


def whole_body(chosen, path, nodes, scene) -> np.ndarray:
    """All particles [T, R', 3], m, of a body in the frames of its poses [T, 7].

    Args:
      chosen: `Beginning`, with the body.
      path: where the motion is given at least in part, else None.
      nodes: float64 [T, R, 3], m, the particles that the model placed.
      scene: of the model.
    """
    if path is None:
        fits = reading_utils.moved_with(chosen.body, chosen.kept)
        return np.stack([fits(points) for points in nodes])
    placed = np.stack([poses.placed(chosen.body, pose) for pose in path])
    if scene.rigid_motion == RigidMotion.DRIVEN:  # the height is the model's
        up = scene.up_axis
        placed[..., up] += (nodes - placed[:, chosen.kept])[..., up].mean(axis=1, keepdims=True)
    return placed
