"""Shipped subspaces: orthonormality, gaps, decoding in float32, what half precision would lose."""

import os

import numpy as np
import tensorflow as tf

from pca_tools import dataset, subspace
from reports.record import ROOT
from reports.stability import shipped as lib
from reports.stability.cases import judged

PART = 'Subspace'
HALF = {'float16': np.float16, 'bfloat16': tf.bfloat16.as_numpy_dtype}


def cases_of(scene):
    """Rows of one shipped dataset."""
    folder = os.path.join(ROOT, 'datasets', scene)
    space = subspace.Subspace.load(os.path.join(folder, 'subspace.npz'))
    run = dataset.read_split(folder, 'test')[0]
    scores = run.position[:, run.n_rigid :].astype(np.float64)
    rows = []

    def add(name, figure, unit, threshold=None, note=''):
        rows.append(judged(PART, f'{scene}: {name}', float(figure), unit, threshold, note))

    product = space.components.T @ space.components - np.eye(space.n_modes)
    eps = np.finfo(float).eps
    add('largest entry of W^T W - I', np.abs(product).max() / eps, 'roundings', 50.0)
    once = space.decode(scores)
    again = space.encode(once)
    add(
        'encode(decode(z)) - z over z',
        np.abs(again - scores).max() / np.abs(scores).max(),
        '',
        1e-13,
    )
    gaps = space.gaps[: space.n_modes]
    add(
        f'gap between singular values {space.n_modes} and {space.n_modes + 1}',
        100 * gaps[-1],
        '%',
        None,
        f'below {100 * subspace.CLUSTER_GAP:g} % the fit warns; smallest gap among the kept ones '
        f'{100 * gaps[:-1].min():.3g} %',
    )
    weights = space.components.astype(np.float32)
    single = tf.einsum('nk,tkd->tnd', weights, scores.astype(np.float32)).numpy() + space.mean
    span = np.ptp(once, axis=(0, 1)).max()
    add('TensorFlow float32 decode against numpy float64', np.abs(single - once).max() / span,
        'of the range', 1e-6)  # fmt: skip
    step = np.diff(scores, axis=0)
    for name, dtype in HALF.items():
        rounding = np.abs(scores.astype(dtype).astype(np.float64) - scores)
        worst = (rounding.std(axis=0).max(axis=1) / step.std(axis=0).max(axis=1)).max()
        add(f'scores in {name}: rounding over the motion per frame, worst mode', worst, '', None,
            'why nothing is stored in half precision')  # fmt: skip
    return rows


def run_all(is_quick, progress):
    """All rows; there are no curves."""
    return [row for scene in progress(lib.SCENES) for row in cases_of(scene)], {}
