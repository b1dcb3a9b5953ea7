"""Rollouts of a swept field over the runs of a dataset, judged as those of all methods."""

import functools
import time
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from learning_to_simulate import error_bound, evaluation
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.swept_field.field import SweptSoil


class FieldRollout(NamedTuple):
    """A one-run `rollout.Rollout` that also holds particles.

    Attributes:
      position, force, judgements, seconds: as of `Rollout`; the modes are those of the predicted
        particles.
      arrays: name -> what else its file holds: predicted_particles [F, P, 3], particle_frames [F],
        particle_indices [P], predicted_torques [T - H, 3].
      facts: physics and quality of the run, see `FieldEvaluator.facts`.
      soils: T - H `SweptSoil`s.
    """

    position: np.ndarray
    force: np.ndarray | None
    judgements: list
    seconds: float
    arrays: dict[str, Any]
    facts: dict[str, Any]
    soils: list


class FieldEvaluator:
    """Rolls out a field, as `evaluation.Evaluator`.

    Args:
      field: `SweptField`.
      reader: `episodes.EpisodeReader` of the dataset.
      metadata: of it.
      split: whose runs these are.
      force_mean: [3] of the training runs, N, for the trivial predictor.

    Attributes:
      reader: as given.
    """

    def __init__(self, field, reader, metadata: dict, split: str, force_mean):
        self._field, self.reader, self._metadata = field, reader, metadata
        self._split, self._mean = split, force_mean

    def episode(self, record: int):
        """`Episode` of a run from its start."""
        return self._episodes[record]

    @functools.cached_property
    def _episodes(self):
        return {e.record: e for e in self.reader.read(self._split)}

    def roll_out(self, group) -> FieldRollout:
        """The rollout of a one-run `RunGroup` of the split."""
        field, axes, tool = self._field, self._field.axes, self._field.tool
        subspace, sample = self.reader.subspace, self.reader.sample(self._split)
        record = int(group.record[0])
        episode = self.episode(record)
        bed = subspace.decode(group.position[0, :1, group.n_rigid :])[0].astype(float)
        ground = episode.ground._replace(points=bed, places=axes.points(bed))
        pose, frames = field.frames(ground, episode.pose, field.scene.dt)
        sampled, n_rigid, n_bed = episode.frames, group.n_rigid, len(bed)
        # Particles of the modes, for those who want modes, and those that the truth has.
        rest = np.concatenate([ground.places, episode.ground.places]) - ground.origin
        clock = time.perf_counter()
        members = field.displacement(frames.at(sampled), rest)
        soil_seconds = time.perf_counter() - clock
        loads = field.loads(frames)
        seconds = time.perf_counter() - clock - soil_seconds
        # Soil is computed in the frames that the truth has; a rollout of all would cost the more.
        seconds += soil_seconds * len(pose) / len(sampled)
        points = rest + ground.origin + members.mean(axis=0).astype(np.float64)
        deepest = 0.0
        for i, frame in enumerate(sampled):
            depth, way = tool.inside(points[i], pose[frame], ground.size)
            deepest, points[i] = max(deepest, float(depth.max())), points[i] + way
        position = group.position[:, H:].copy()
        if tool.predicts_height:
            change = (pose - episode.pose)[H:, 1]
            position[0, :, :n_rigid, axes.up] += change[:, None]
        modes = subspace.encode(bed + axes.world(points[:, :n_bed] - ground.places))
        at = np.arange(len(pose))
        # Modes of the frames between: on the straight line.
        between = [np.interp(at, sampled, column) for column in modes.reshape(len(sampled), -1).T]
        modes = np.stack(between, axis=-1).reshape(len(at), *modes.shape[1:])
        position[0, :, n_rigid:] = modes[H:]
        force, torque = axes.world_loads(loads.mean(axis=0)[H:, :3])
        values = field.judged(episode.path, frames, field.scene.dt)
        finite = bool(np.isfinite(points).all() and np.isfinite(loads).all())
        moved, late = axes.world(points[:, n_bed:] - episode.ground.places), sampled >= H
        return FieldRollout(
            position=position,
            force=force[None].astype(np.float32),
            judgements=[field.limits.judge(values, 0, finite)],
            seconds=seconds,
            arrays={
                'predicted_particles': (sample[record][:1] + moved)[late].astype(np.float32),
                'particle_frames': sampled[late],
                'particle_indices': np.asarray(sample.indices),
                'predicted_torques': torque.astype(np.float32),
            },
            facts=self.facts(
                episode, pose, frames, members[:, :, n_bed:], points[:, n_bed:], loads, deepest
            ),
            soils=[
                SweptSoil(field, frames.at(slice(t, t + 1)), pose[t], ground, subspace)
                for t in range(H, len(pose))
            ],
        )

    def facts(self, episode, pose, frames, members, points, loads, deepest) -> dict:
        """Errors in full space, physics and quality of one run.

        Args:
          episode: of the run.
          pose: [T, K] of the tool, as predicted.
          frames: its `Frame`s.
          members: [M, F, P, 3] predicted displacements of the sample.
          points: [F, P, 3] its predicted places, pushed out.
          loads: [M, T, 3 or 4].
          deepest: how deep a particle lay in the tool before it was pushed out, m.

        Returns:
          soil_mm, still_mm, force_l2; penetration_mm before the push-out and in the truth;
          heap_litre, true_heap_litre at the end: of the soil over the untouched surface; those of
          the tool, see `Tool.facts`; errors and bounds of frames for `reliability`.
        """
        field, late, ground = self._field, episode.frames >= H, episode.ground
        truth = ground.places + episode.moved

        def rms_mm(difference):
            return float(1e3 * np.sqrt((difference[late] ** 2).mean()))

        def relative(force):
            size = np.linalg.norm(episode.load[H:, :2])
            return float(np.linalg.norm(force[H:, :2] - episode.load[H:, :2]) / size)

        frame_mm = 1e3 * np.sqrt(((points - truth) ** 2).mean(axis=(1, 2)))
        load_error = loads.mean(axis=0)[:, :2] - episode.load[:, :2]
        true_depth = max(
            float(field.tool.inside(p, episode.pose[f], ground.size)[0].max())
            for p, f in zip(truth, episode.frames, strict=True)
        )
        volume = field.kept_spacing**3 * len(field.rest) / len(ground.places)
        places, surface = ground.origin[0] + field.grid.offsets, ground.bed.surface[0]
        heaps = [
            1e3 * float(volume * np.count_nonzero(p[:, 1] > np.interp(p[:, 0], places, surface)))
            for p in (points[-1], truth[-1])
        ]
        frames_of = {
            'soil_error': frame_mm[late],
            'soil_spread': (1e3 * error_bound.spread(members))[late],
            'soil_size': (1e3 * error_bound.size(members))[late],
            'force_error': np.sqrt((load_error[H:] ** 2).mean(axis=1)).astype(float),
            'force_spread': error_bound.spread(loads[..., :2])[H:],
            'force_size': error_bound.size(loads[..., :2])[H:],
        }
        return {
            'record': episode.record,
            'soil_mm': float(np.sqrt((frame_mm[late] ** 2).mean())),
            'still_mm': rms_mm(episode.moved),
            'force_l2': relative(loads.mean(axis=0)),
            'soil_mm_of_members': [rms_mm(m - episode.moved) for m in members],
            'force_l2_of_members': [relative(m) for m in loads],
            'penetration_mm': 1e3 * deepest,
            'true_penetration_mm': 1e3 * true_depth,
            'heap_litre': heaps[0],
            'true_heap_litre': heaps[1],
            **field.tool.facts(episode, pose, frames, loads.mean(axis=0)),
            'frames': frames_of,
        }

    def run(self, groups, split: str, progress=iter):
        """Rolls out every run; arguments and results as of `evaluation.Evaluator.run`, with the
        facts of each run as `field` of the summary."""
        results = evaluation.roll_out_all(self.roll_out, groups, progress)
        summary = evaluation.summarise(
            results, model_of(self._field, self._mean), self._metadata, split
        )
        facts = [dict(rollout.facts) for _, _, rollout in results]
        for kind in error_bound.FLOORS:
            parts = [f'{kind}_{part}' for part in ('error', 'spread', 'size')]
            runs = [[fact['frames'][part] for part in parts] for fact in facts]
            weights = self._field.calibration.get(kind)
            summary.setdefault('reliability', {})[kind] = {
                'weights': weights,
                'weights_of_this_split': error_bound.calibrate(runs, kind),
                'groups': [] if weights is None else error_bound.reliability(runs, weights),
            }
        for fact in facts:
            del fact['frames']
        return results, summary | {'field': facts}


def model_of(field, force_mean) -> SimpleNamespace:
    """A field as `evaluation.summarise` and the API take a model."""
    statistics = SimpleNamespace(force_mean=np.asarray(force_mean, np.float64))
    simulator = SimpleNamespace(scene=field.scene, config=field.config, statistics=statistics)
    n_mode = field.scene.n_modes

    def layout(n_rigid):
        return SimpleNamespace(n_node=n_rigid + n_mode, n_edge=0, senders=(), receivers=())

    return SimpleNamespace(
        simulator=simulator, field=field, layout=layout, edge_counts=dict, mode_mask=None
    )
