"""Checks of the subspace that belongs to a dataset: our `subspace.npz`, or the authors' pickles."""

from __future__ import annotations

import os

import numpy as np

from pca_tools import files, legacy_pickles
from pca_tools.dataset import Trajectory
from pca_tools.inspection.findings import Inspection
from pca_tools.subspace import CLUSTER_GAP, Subspace


def check_subspace(inspection: Inspection) -> None:
    """`subspace.npz` against metadata and splits."""
    held = inspection.metadata
    name = held.get('pca', {}).get('file')
    if name is None:
        return
    try:
        space = Subspace.load(os.path.join(inspection.folder, os.path.basename(name)))
    except (ValueError, OSError) as error:
        inspection.error(str(error))
        return
    inspection.n_soil, inspection.floors = space.n_soil, space.projection_floors
    for what, promised, found in (
        ('digest', held['pca'].get('digest'), space.digest),
        ('mode_number', held['mode_number'], space.n_modes),
        ('n_soil', held.get('n_soil'), space.n_soil),
    ):
        if promised != found:
            inspection.error(
                f'{name}: {what} is {found}, the metadata says {promised}; the scores belong to '
                'another subspace'
            )
    others = [*held.get('cases', {}).get('valid', []), *held.get('cases', {}).get('test', [])]
    seen = {str(case.get('case')) for case in others} & set(space.runs)
    if seen:
        inspection.error(f'{name}: was fitted on {sorted(seen)}, which are not training runs')
    else:
        inspection.ok(
            f'{name}: {space.n_modes} modes of N = {space.n_soil}, fitted on training runs only'
        )
    rest = len(space.singular_values) - space.n_modes
    if rest and space.gaps[space.n_modes - 1] < CLUSTER_GAP:
        inspection.warn(
            f'{name}: singular values {space.n_modes} and {space.n_modes + 1} differ by only '
            f'{100 * space.gaps[space.n_modes - 1]:.1f} %: the last mode may turn from fit to fit'
        )


def check_legacy_files(inspection: Inspection) -> None:
    """The authors' pickles beside their records."""
    vectors = os.path.join(inspection.folder, legacy_pickles.EIGENVECTORS_NAME)
    if os.path.exists(vectors):
        try:
            files.refuse_git_lfs_pointer(vectors)
        except ValueError as error:
            inspection.warn(f'{error}; scores cannot be decoded, errors are given in the subspace')
    path = os.path.join(inspection.folder, legacy_pickles.EIGENVALUES_NAME)
    if not os.path.exists(path):
        return
    try:
        eigenvalues = legacy_pickles.read_array(path)
    except ValueError as error:
        inspection.warn(str(error))
        return
    negative = int(np.count_nonzero(eigenvalues.real < 0))
    if np.iscomplexobj(eigenvalues) or negative:
        inspection.warn(
            f'{legacy_pickles.EIGENVALUES_NAME}: type {eigenvalues.dtype}, {negative} of '
            f'{len(eigenvalues)} values are '
            'negative: they come from a solver for non-symmetric matrices; negative ones are '
            'taken as 0'
        )
    inspection.n_soil = len(eigenvalues)
    if inspection.runs:
        inspection.floors, runs = floors_of_eigenvalues(eigenvalues.real, inspection.runs)
        inspection.warn(
            f'the mode energies of the records fit eigenvalues of {runs:.0f} runs: the published '
            'modes were fitted on all '
            'runs, validation and test included'
        )


def floors_of_eigenvalues(
    eigenvalues: np.ndarray, runs: list[Trajectory]
) -> tuple[np.ndarray, float]:
    """Turns the published eigenvalues into truncation errors.

    They are those of X^T X / (N - 1) (thesis Algorithm 1), so their sum grows with the number of
    runs, which is not written anywhere. It follows from the energy of the kept modes in the
    records.

    Args:
        eigenvalues: [N], descending; negative ones count as 0.
        runs: some runs of the same subspace.

    Returns:
        floors in m^2 for 0..N modes [N + 1], and the number of runs the eigenvalues were summed
        over.
    """
    energies = np.maximum(eigenvalues, 0.0) * (len(eigenvalues) - 1)
    n_modes, n_rows = runs[0].n_modes, 3 * runs[0].n_frames
    per_run = np.mean(
        [np.sum(run.position[:, run.n_rigid :].astype(np.float64) ** 2) for run in runs]
    )
    n_runs = float(energies[:n_modes].sum() / per_run)
    tails = np.concatenate([[energies.sum()], energies.sum() - np.cumsum(energies)])
    return np.maximum(tails, 0.0) / (n_runs * n_rows * len(eigenvalues)), n_runs
