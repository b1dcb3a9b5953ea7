"""A made-up excavation: a bed of particles, a 4 x 5 blade and a bump of soil that it pushes.

The motion is a closed form, so that positions, velocities and forces are known without a solver.
"""

import json
import os

import numpy as np

from pca_tools import files
from pca_tools import subspace as subspace_lib

DT = 1 / 60
N_GIVEN = 6
N_RIGID = 20
N_FRAMES, N_MODES = 60, 8


def bed(n_x: int, n_y: int, n_z: int, seed: int = 0) -> np.ndarray:
    """Returns [N, 3] particles of a bed 0.8 x 0.15 x 0.6 m, jittered."""
    grid = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in (n_x, n_y, n_z)), indexing='ij'), -1)
    jitter = np.random.default_rng(seed).uniform(-0.35, 0.35, grid.shape)
    cells = (grid + jitter) / [n_x, n_y, n_z]
    return (cells * [0.8, 0.15, 0.6] + 0.1).reshape(-1, 3)


def blade(time: np.ndarray, depth: float, speed: float) -> np.ndarray:
    """Returns [T, 20, 3] points of a blade that dips in and is driven towards -x."""
    row, column = np.divmod(np.arange(N_RIGID), 5)
    lean = np.deg2rad(10.0)
    points = np.stack(
        [0.1 * row * np.sin(lean), 0.1 * row * np.cos(lean), 0.4 + 0.1 * (column - 2)], axis=-1
    )
    way = np.stack(
        [0.82 - speed * time, 0.257 - depth * np.clip(time / 0.8, 0, 1), 0 * time], axis=-1
    )
    return points + way[:, None]


def pushed_soil(start: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Returns [T, N, 3]: particles in the blade's way are carried along and heaped up before it."""
    tip = body[:, 0]
    across = np.exp(-(((start[:, 2] - 0.4) / 0.2) ** 6))
    frames = []
    for x, y, _ in tip:
        cut = np.clip((start[:, 1] - y + 0.02) / 0.04, 0.0, 1.0) * across
        passed = 0.045 * cut / (1.0 + np.exp((x - start[:, 0]) / 0.015))
        heap = 0.05 * cut * np.exp(-(((start[:, 0] - x + 0.06) / 0.05) ** 2))
        frames.append(start + np.stack([-passed - 0.3 * heap, heap, 0 * heap], axis=-1))
    return np.array(frames)


def write(folder: str) -> tuple[str, str, np.ndarray]:
    """Writes a dataset folder with `subspace.npz` and a rollout of it.

    Returns:
        (path of the rollout, dataset folder, float64 [T, N, 3] particles before any projection).
    """
    data_path = os.path.join(folder, 'dataset')
    os.makedirs(data_path, exist_ok=True)
    time = DT * np.arange(N_FRAMES)
    body = blade(time, depth=0.08, speed=0.5 / time[-1])
    soil = pushed_soil(bed(20, 6, 12), body)
    space = subspace_lib.fit([soil], N_MODES)
    space.save(os.path.join(data_path, 'subspace.npz'))

    rng = np.random.default_rng(1)
    truth = np.concatenate([body, space.encode(soil)], axis=1)
    drift = np.zeros_like(truth)
    growth = np.clip(np.arange(N_FRAMES) - N_GIVEN + 1, 0, None) / N_FRAMES
    drift[:, N_RIGID:] = growth[:, None, None] * rng.normal(0, 0.12, (N_MODES, 3))
    prediction = truth + drift
    parameters = [
        {'case': 125, 'depth_m': 0.08, 'speed_m_s': 0.1, 'angle_deg': 10.0, 'seed': 3, 'soil': {}},
        {'case': 7, 'depth_m': 0.02, 'speed_m_s': 0.1, 'angle_deg': 3.8, 'seed': 4},
    ]
    metadata = {
        'dt': DT,
        'bounds': [[0.0, 1.2], [0.0, 0.8], [0.0, 0.8]],
        'sequence_length': N_FRAMES - 1,
        'default_connectivity_radius': 0.025,
        'dim': 3,
        **{f'{name}_{end}': [1.0] * 3 for name in ('vel', 'acc') for end in ('mean', 'std')},
        'mode_number': N_MODES,
        'n_soil': space.n_soil,
        'scene': {'name': 'excavation', 'rigid_motion': 'prescribed'},
        'pca': {'digest': space.digest},
        'cases': {'train': parameters[1:], 'test': parameters[:1]},
        'projection_mse': {'train': [0.0], 'test': [float(space.projection_floor())]},
    }
    arrays = {
        'initial_positions': truth[:N_GIVEN].astype(np.float32),
        'predicted_rollout': prediction[N_GIVEN:].astype(np.float32),
        'ground_truth_rollout': truth[N_GIVEN:].astype(np.float32),
        'particle_types': np.array([3] * N_RIGID + [6] * N_MODES, np.int64),
        'metadata': np.array(json.dumps(metadata)),
    }
    smooth = np.stack([120 * (1 - np.exp(-3 * time)), -60 * (1 - np.exp(-5 * time)), 0 * time])
    force = smooth.T + rng.normal(0, [8, 8, 0], (N_FRAMES, 3))
    arrays |= {
        'initial_forces': force[:N_GIVEN].astype(np.float32),
        'ground_truth_forces': force[N_GIVEN:].astype(np.float32),
        'predicted_forces': 0.92 * smooth.T[N_GIVEN:].astype(np.float32),
    }
    rollout_path = os.path.join(folder, 'rollout_test_0.npz')
    files.write_npz(rollout_path, **arrays)
    return rollout_path, data_path, soil
