"""Runs of a dataset as particles: every k-th soil particle beside all rigid particles."""

import os

import numpy as np

from learning_to_simulate.reading_utils import RunGroup, context_of
from pca_tools import dataset
from pca_tools.raw_runs import RawRuns
from pca_tools.subspace import Subspace

SOIL_TYPE = 6  # of the authors' records
RAW, DECODED = 'raw runs', 'decoded from the subspace'


def thinned_indices(n_soil: int, wanted: int) -> np.ndarray:
    """Indices of every k-th of N soil particles, k so that about `wanted` are left; ValueError if
    there are fewer."""
    if wanted > n_soil:
        raise ValueError(f'soil_particles is {wanted}, but the runs have {n_soil} soil particles')
    return np.arange(0, n_soil, max(round(n_soil / wanted), 1))


def read_runs(data_path, raw_path, split, metadata, soil_particles) -> RunGroup:
    """All runs of a split as one group of V = R + kept soil particles (about `soil_particles`),
    from the folder of the raw runs of its cases, or (None) decoded from the records.

    Raises:
      FileNotFoundError: no such split, raw folder or subspace.
      ValueError: raw runs that lack a case of the split or differ from the dataset, records with
        other numbers of rigid particles or frames, or without a subspace.
    """
    records = dataset.read_split(data_path, split)
    soils = _decoded_soil(data_path, records)
    if raw_path:
        soils = _raw_soil(raw_path, metadata, data_path, split, records)
    positions = []
    for i, (run, soil) in enumerate(zip(records, soils)):
        kept = thinned_indices(soil.shape[1], soil_particles)
        rigid = run.position[:, : run.n_rigid].astype(np.float64)
        positions.append(np.concatenate([rigid, soil[:, kept]], axis=1))
        if positions[-1].shape != positions[0].shape or run.n_rigid != records[0].n_rigid:
            raise ValueError(
                f'{data_path}: {split} record {i} has {run.n_rigid} rigid particles and '
                f'{len(run.position)} frames, unlike those before: full_space takes equal runs only'
            )
    first = records[0]
    n_soil = positions[0].shape[1] - first.n_rigid
    return RunGroup(
        n_rigid=first.n_rigid,
        particle_type=np.append(first.particle_type[: first.n_rigid], [SOIL_TYPE] * n_soil),
        position=np.stack(positions),
        force=None if first.force is None else np.stack([r.force for r in records]).astype(float),  # type: ignore[misc]
        context=context_of(records),
        record=np.arange(len(records)),
    )


def _decoded_soil(data_path, records):
    path = os.path.join(data_path, 'subspace.npz')
    if not os.path.isfile(path):
        raise FileNotFoundError(
            f'{path}: no such file; without a subspace full_space needs the raw runs (--raw_path)'
        )
    space = Subspace.load(path)
    yield from (space.decode(run.position[:, run.n_rigid :]) for run in records)


def _raw_soil(raw_path, metadata, data_path, split, records):
    """Soil particles of the raw run of each record, checked against it."""
    raw = RawRuns(raw_path)
    cases = [entry['case'] for entry in metadata.get('cases', {}).get(split, [])]
    if len(cases) != len(records):
        raise ValueError(
            f'metadata.json names {len(cases)} cases of {split} for {len(records)} records: raw '
            f'runs cannot be found for them'
        )
    if lacking := sorted(set(cases) - set(raw.cases)):
        raise ValueError(f'{raw_path}: lacks the runs of the {split} cases {lacking}')
    for i, (case, record) in enumerate(zip(cases, records)):
        run, body = raw[raw.cases.index(case)], record.position[:, : record.n_rigid]
        if run.rigid_positions.shape != body.shape or not np.allclose(
            run.rigid_positions, body, atol=1e-5
        ):
            raise ValueError(
                f'{raw_path}: the body of case {case} does not move as in {split} record {i} of '
                f'{data_path}: the raw runs are of another dataset'
            )
        yield run.positions.astype(np.float64)
