"""Statistics of a dataset: what its metadata holds and what its errors are measured against."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pca_tools.dataset import KINEMATIC_PARTICLE_ID, Trajectory

HISTORY = 6  # H, frames that a model is given


def motion_statistics(trajectories: Sequence[Trajectory]) -> dict[str, list[float]]:
    """Computes the normalisation statistics of DeepMind's metadata and of the authors'.

    Returns:
        `vel_mean, vel_std, acc_mean, acc_std` [3] per frame (v_t = x_t - x_{t-1}, a_t = v_t -
        v_{t-1}, not divided by dt), over all nodes that are not kinematic; the same of
        `rigid_body_force`, `rigid_body_torque` [3] and `context` [C] where the runs have them.
    """
    moving = [
        run.position[:, run.particle_type != KINEMATIC_PARTICLE_ID].astype(np.float64)
        for run in trajectories
    ]
    statistics = {}
    for name, samples in (
        ('vel', [np.diff(positions, axis=0) for positions in moving]),
        ('acc', [np.diff(positions, n=2, axis=0) for positions in moving]),
        ('rigid_body_force', [run.force for run in trajectories]),
        ('rigid_body_torque', [run.torque for run in trajectories]),
        ('context', [run.step_context for run in trajectories]),
    ):
        if samples[0] is not None:
            rows = np.concatenate([sample.reshape(-1, sample.shape[-1]) for sample in samples])
            rows = rows.astype(np.float64)
            statistics[f'{name}_mean'] = rows.mean(axis=0).tolist()
            statistics[f'{name}_std'] = rows.std(axis=0).tolist()
    return statistics


def mean_share(shares: Sequence[float], weights: Sequence[float]) -> float:
    """Returns the mean of shares of energy, each weighted by its energy; 1 if there is none."""
    total = float(np.sum(weights))
    return float(np.dot(shares, weights)) / total if total > 0 else 1.0


def trivial_errors(trajectory: Trajectory, n_soil: int) -> dict[str, float]:
    """Mean squared errors (m^2) of the predictors that need no model, `stay_still` and
    `constant_velocity`, on the soil of a run of more than `HISTORY` frames, inside the subspace.

    W is orthonormal, so squared score errors / (3 N) are mean squared particle errors.
    """
    scores = trajectory.position[:, trajectory.n_rigid :].astype(np.float64)
    last, truth = scores[HISTORY - 1], scores[HISTORY:]
    steps = np.arange(1, len(truth) + 1)[:, None, None]
    velocity = last - scores[HISTORY - 2]
    return {
        name: float(np.mean(np.sum((prediction - truth) ** 2, axis=(1, 2))) / (3 * n_soil))
        for name, prediction in (
            ('stay_still', last),
            ('constant_velocity', last + steps * velocity),
        )
    }
