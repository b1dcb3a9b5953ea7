"""A made-up rollout of an excavation: a run of `synthetic`, and a prediction that drifts away."""

import json
import os

import numpy as np

from learning_to_simulate import evaluation
from learning_to_simulate.rollout_status import OK
from pca_tools import dataset, files
from pca_tools.subspace import Subspace
from tests.learning_to_simulate import synthetic

DT, N_GIVEN, N_RIGID, N_FRAMES = 1 / 60, 6, 20, synthetic.N_FRAMES
TYPES = np.repeat([3, 6], [N_RIGID, synthetic.N_MODES])
CASES = [
    {'case': 125, 'depth_m': 0.08, 'speed_m_s': 0.1, 'angle_deg': 10.0, 'seed': 3, 'soil': {}},
    {'case': 7, 'depth_m': 0.02, 'speed_m_s': 0.1, 'angle_deg': 3.8, 'seed': 4},
]


def write(folder: str) -> tuple[str, str]:
    """Writes a dataset with a subspace, and a rollout of its first test run by a 4 x 5 blade;
    returns the path of the rollout and the dataset folder."""
    data_path = synthetic.write_dataset(os.path.join(folder, 'dataset'), rigid_counts=(N_RIGID,))
    synthetic.write_subspace(data_path)
    metadata = dataset.read_metadata(data_path) | {
        'scene': {'name': 'excavation', 'rigid_motion': 'prescribed', 'force': True},
        'pca': {'digest': Subspace.load(os.path.join(data_path, 'subspace.npz')).digest},
        'cases': {'test': CASES},
        'projection_mse': {'test': [2e-6, 1e-6]},
    }
    run = dataset.read_split(data_path, 'test')[0]
    truth = run.position.astype(float)
    truth[:, :N_RIGID, 2] += 0.1 * (np.arange(N_RIGID) % 5)
    predicted, rng = truth[N_GIVEN:].copy(), np.random.default_rng(1)
    growth = np.arange(1, len(predicted) + 1) / N_FRAMES
    predicted[:, N_RIGID:] += growth[:, None, None] * rng.normal(0, 0.12, (synthetic.N_MODES, 3))
    arrays = evaluation.file_arrays(
        truth[:N_GIVEN], predicted, truth[N_GIVEN:], TYPES, OK, 0.9 * run.force[N_GIVEN:], run.force
    )
    path = os.path.join(folder, 'rollout_test_0.npz')
    files.write_npz(path, **arrays, metadata=np.array(json.dumps(metadata)))
    return path, data_path
