"""Rollouts of particles, step by step on the host, with their errors, time and memory."""

import resource
import time

import numpy as np

from learning_to_simulate import evaluation
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.full_space.simulator import history_of
from learning_to_simulate.rollout import Rollout
from learning_to_simulate.rollout_status import Judgement, RolloutStatus


class ParticleEvaluator:
    """As `evaluation.Evaluator`; the rows of the model also hold the mean number of edges, and the
    peak memory of the process so far (`peak_memory_mb`).

    Args:
      model: `method.ParticleModel`.
      metadata: of the dataset where particles are decoded from it, else {}: nothing is cut off.
    """

    def __init__(self, model, metadata):
        self._model, self._metadata, self._edges = model, metadata, {}

    def roll_out(self, group) -> Rollout:
        """Rolls out the one run of a group from its first H frames; stops where it blows up."""
        simulator = self._model.simulator
        n, n_frame = group.n_rigid, group.position.shape[1]
        position, velocity = history_of(group, 0, H - 1)
        simulator.step(position, velocity, np.zeros((n, 3)), group.context_at(H, 0), n)  # warm-up
        positions = np.full((1, n_frame - H, *position.shape), np.nan)
        forces = (
            np.full((1, n_frame - H, 3), np.nan, np.float32) if group.force is not None else None
        )
        edges, judgement = [], Judgement(RolloutStatus.OK)
        start = time.perf_counter()
        for k in range(n_frame - H):
            body = group.position[0, H + k, :n] - group.position[0, H + k - 1, :n]
            displacement, force, n_edge = simulator.step(
                position, velocity, body, group.context_at(H + k, 0), n
            )
            position = position + displacement
            velocity = np.concatenate([velocity[1:], displacement[None]])
            if not (np.isfinite(position).all() and (force is None or np.isfinite(force).all())):
                judgement = Judgement(RolloutStatus.NON_FINITE, H + k, -1, 'not a number')
                break
            positions[0, k] = position
            if forces is not None:
                forces[0, k] = force
            edges.append(n_edge)
        self._edges[int(group.record[0])] = float(np.mean(edges)) if edges else 0.0
        return Rollout(positions, forces, [judgement], time.perf_counter() - start)

    def run(self, groups, split: str, progress=iter):
        """As `Evaluator.run`, with edges and memory in the metrics."""
        results = evaluation.roll_out_all(self.roll_out, groups, progress)
        summary = evaluation.summarise(results, self._model, self._metadata, split)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        for row in summary['runs']['model']:
            row |= {'edges': round(self._edges[row['record']]), 'peak_memory_mb': peak}
        summary['mean']['model']['peak_memory_mb'] = peak
        return results, summary | {'particles': self._model.simulator.scene.n_soil}
