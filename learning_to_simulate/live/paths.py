"""Whole paths: from poses to a rollout that can be looked at, saved and drawn."""

import dataclasses
import json

import numpy as np
from scipy.spatial.transform import Rotation

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.evaluation import file_arrays, soil_of_run, total_force
from learning_to_simulate.live import poses, soil
from learning_to_simulate.live.starts import Start
from learning_to_simulate.rollout_status import Judged, Judgement, RolloutStatus
from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.soil_truth import PARTICLES, SoilTruth
from pca_tools import dataset, files


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class SoilRollout(Judged):
    """A predicted run of T' frames after H given ones.

    Attributes:
      history: float64 [H, V, 3], m: the given frames; R nodes of the body, then r modes.
      modes: float64 [T', r, 3] scores, m.
      force: float32 [T', 3], N, or None.
      judgement: the worst status, with the first frame in which it holds and the reason.
      frame_status: T' statuses: of each frame of a path alone; of a recorded run, from the first
        bad frame on.
      body: float64 [H + T', R', 3], m: all particles of the body.
      scene: `Scene`.
      truth: (modes [H + T', r, 3], body [H + T', R', 3], force [H + T', 3] or None) of a recorded
        run; None of a path.
      name: for files and titles.
      soil_truth: `soil_truth.SoilTruth` of a recorded run, else None.
      sampled: float64 [F, P, 3], m: the predicted particles that it is compared with.
      decoder: `live.soil.Decoder`; None without a subspace.
    """

    history: np.ndarray
    modes: np.ndarray
    force: np.ndarray | None
    judgement: Judgement
    frame_status: tuple[RolloutStatus, ...]
    body: np.ndarray
    scene: Scene
    truth: tuple | None = None
    name: str = 'rollout'
    soil_truth: SoilTruth | None = None
    sampled: np.ndarray | None = None
    decoder: soil.Particles | None = None

    torque = None  # none of these models predicts one

    def __len__(self) -> int:
        return len(self.modes)

    @property
    def soil_mm(self) -> float | None:
        """The error of soil of a recorded run, mm (see `soil_truth`); None of a path."""
        return None if self.soil_truth is None else self.soil_truth.soil_mm(self.sampled)

    @property
    def time(self) -> np.ndarray:
        """float64 [T'], s after the start."""
        return self.scene.dt * np.arange(1, len(self) + 1)

    @property
    def has_particles(self) -> bool:
        return self.decoder is not None

    def particles(self, frame: int | None = None) -> np.ndarray:
        """float32 [N, 3] of a frame, or [T', N, 3] of all, m; ValueError without a subspace."""
        if frame is None:
            return np.stack([self.particles(k) for k in range(len(self))])
        return soil.known(self.decoder).particles(self.modes[frame])

    def save(self, path: str) -> None:
        """Writes an `.npz` that `render_rollout` reads, whole or not at all; DeepMind's key
        names."""
        scene, n_rigid = self.scene, self.body.shape[1]
        given = scene.rigid_motion == RigidMotion.PRESCRIBED
        kind = dataset.KINEMATIC_PARTICLE_ID if given else dataset.RIGID_PARTICLE_ID
        given_modes = self.history[:, self.history.shape[1] - scene.n_modes :]
        nodes = np.concatenate([self.body, np.concatenate([given_modes, self.modes])], axis=1)
        true, true_force = None, None
        if self.truth is not None:
            true_modes, true_body, true_force = self.truth
            true = np.concatenate([true_body, true_modes], axis=1)[H:]
        types = np.repeat([kind, dataset.MODE_PARTICLE_ID], [n_rigid, scene.n_modes])
        arrays = file_arrays(
            nodes[:H], nodes[H:], true, types, self.judgement, self.force, true_force
        )
        arrays['scene'] = np.array(json.dumps(scene.to_json()))
        if self.soil_truth is not None and self.soil_truth.space == PARTICLES:
            arrays['predicted_particles'] = self.sampled.astype(np.float32)
            arrays['particle_frames'] = self.soil_truth.frames
            arrays['particle_indices'] = self.soil_truth.indices
        files.write_npz(path, **arrays)

    def render(self, path: str, step_stride: int = 3, **options) -> None:
        """Draws the rollout into a file .png, .gif or .mp4, every step_stride-th frame; options
        `color_by` and `plane` of `render_rollout.render_frames`. ValueError: another ending, or a
        package for pictures is missing (pip install .[viz])."""
        from learning_to_simulate import render_rollout
        from learning_to_simulate.rendering import rollout_frames

        target, kind = render_rollout.target_and_format(path)
        frames = rollout_frames.of_rollout(self, step_stride)
        render_rollout.render_frames(frames, target, [kind], step_stride, **options)


def roll_out(stepper, path, velocity=None, case=None, context=None) -> SoilRollout:
    """Steps a model along a path, by a `stepper.Stepper` that flags; it is left at the end of it.

    The path has T >= 2 poses [T, 7] or [T, 3] (see `poses`); the body is at the first when it
    starts, with `velocity`, None for that of its first two poses. Case and context are those of
    `Stepper.start`; a context that changes in time is [T, C]. ValueError for no such path; as
    `Stepper.step`.
    """
    scene, names = stepper.scene, stepper.scene.context_names
    values = poses.numbers('path', path, (None, 7), (None, 3))
    if len(values) < 2:
        raise ValueError(f'a path of {len(values)} poses has no step, at least two are needed')
    contexts = [None] * len(values)
    if np.ndim(context) == 2 and names:
        contexts = poses.numbers('context', context, (len(values), len(names)))
        context = contexts[0]
    start = Start(scene, stepper.starts, case=case, context=context)
    values = np.stack([start.read(pose) for pose in values])
    if velocity is None:
        velocity = velocity_between(values[0], values[1], scene.dt)
    stepper.start(values[0], velocity, case, context)
    start = stepper.start_of_run
    known = scene.rigid_motion.is_known
    frames = [
        stepper.step(pose if known else None, now)
        for pose, now in zip(values[1:], contexts[1:], strict=True)
    ]
    history, n = start.history(), len(start.kept)
    body = np.concatenate([history[:, :n], [frame.rigid_pose for frame in frames]])
    if known:  # else all of its particles are nodes
        body = _whole_body(start, np.concatenate([start.past(), values[1:]]), body, scene)
    force = None
    if frames[0].force is not None:
        force = np.array([frame.force for frame in frames], np.float32)
    return SoilRollout(
        history=history,
        modes=np.stack([frame.modes for frame in frames]),
        force=force,
        judgement=frames[-1].judgement,
        frame_status=tuple(frame.now.status for frame in frames),
        body=body,
        scene=scene,
        decoder=frames[0].decoder,
    )


def of_recorded_run(group, rollout, scene, decoder, name: str) -> SoilRollout:
    """The rollout of a recorded run, with its truth: of a one-run `RunGroup`, its
    `rollout.Rollout`, the scene of the model, and a `live.soil.Decoder` or None."""
    (judgement,) = rollout.judgements
    history = group.position[0, :H]
    true = group.all_particles(group.position, as_recorded=True)[0]
    predicted = group.all_particles(np.concatenate([history[None], rollout.position], axis=1))[0]
    n_body = true.shape[1] - scene.n_modes - group.n_left_modes
    modes = slice(n_body, n_body + scene.n_modes)
    soil_truth, sampled = soil_of_run(group, rollout, scene)
    true_force = None if group.force is None else total_force(group.force[0])
    statuses = (
        judgement.status if 0 <= judgement.frame <= k else RolloutStatus.OK
        for k in range(H, len(true))
    )  # fmt: skip
    return SoilRollout(
        history=history,
        modes=rollout.position[0, :, group.n_rigid :],
        force=None if rollout.force is None else total_force(rollout.force[0]),
        judgement=judgement,
        frame_status=tuple(statuses),
        body=predicted[:, :n_body],
        scene=scene,
        truth=(true[:, modes], true[:, :n_body], true_force),
        name=name,
        soil_truth=soil_truth,
        sampled=sampled,
        decoder=decoder,
    )


def velocity_between(first, second, seconds: float) -> np.ndarray:
    """Linear and angular velocity [6] that lead from a pose [7] to another one in some time."""
    turns = [Rotation.from_quat(np.roll(pose[3:], -1)) for pose in (first, second)]
    angular = (turns[1] * turns[0].inv()).as_rotvec()
    return np.concatenate([second[:3] - first[:3], angular]) / seconds


def _whole_body(start, path, nodes, scene) -> np.ndarray:
    """All particles [T, R', 3], m, of the body of a start in the frames of its poses [T, 7], of
    which the model placed `nodes` [T, R, 3]."""
    placed = np.stack([poses.placed(start.body, pose) for pose in path])
    if scene.rigid_motion == RigidMotion.DRIVEN:  # the height is the model's
        up = scene.up_axis
        placed[..., up] += (nodes - placed[:, start.kept])[..., up].mean(axis=1, keepdims=True)
    return placed
