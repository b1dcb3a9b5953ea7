"""Trajectories for NRI: our subspace datasets and Kipf's `.npy` folders, through one loader.

A folder with `metadata.json` is a dataset of this project; its features are position and velocity
of the modes (and of the rigid particles, if asked for). Otherwise the folder holds loc_, vel_ and
edges_*.npy, as `nri.simulate` or Kipf et al. write them.
"""

import dataclasses
import hashlib
import os
import re

import numpy as np

from pca_tools import dataset, files

NODE_KINDS = ('modes', 'modes_and_rigid')


@dataclasses.dataclass(frozen=True, eq=False)
class NriData:
    """One split."""

    features: np.ndarray  # float32 [S, V, T, F], units of the files: positions, then velocities
    edges: np.ndarray | None  # int32 [S, V (V - 1)] true edge types in Kipf's order
    node_names: tuple[str, ...]  # V
    same_scale: bool  # whether all nodes share one scale; not so for modes
    digest: str  # sha256 over the files that were read
    source: str  # folder and split, for messages


def load(path: str, split: str, nodes: str = 'modes', modes: int = 0) -> NriData:
    """Reads a split of either kind of folder; of a dataset of this project the `nodes` (of
    `NODE_KINDS`), and of its modes the first `modes` (0: all).

    FileNotFoundError: no such folder or split. ValueError, with the file: it is damaged or foreign,
    arrays do not fit each other, or values are not finite."""
    if split not in dataset.SPLITS:
        raise ValueError(f'split {split!r} is not one of {dataset.SPLITS}')
    if nodes not in NODE_KINDS:
        raise ValueError(f'nodes {nodes!r} is not one of {NODE_KINDS}')
    if not os.path.isdir(path):
        raise FileNotFoundError(f'{path}: no such folder')
    is_ours = os.path.exists(os.path.join(path, 'metadata.json'))
    if modes and not is_ours:
        raise ValueError(f'{path}: is no dataset of this project, it has no modes to choose from')
    data = _load_subspace(path, split, nodes, modes) if is_ours else _load_kipf(path, split)
    if data.features.shape[1] < 2:
        raise ValueError(f'{data.source}: has one node, a relation needs at least two')
    return data


def _digest(paths) -> str:
    return hashlib.sha256(''.join(map(files.sha256_of_file, paths)).encode()).hexdigest()


def _load_subspace(path, split, nodes, modes):
    runs = dataset.read_split(path, split)
    up = dataset.read_metadata(path).get('scene', {}).get('up_axis', 1)
    if modes > runs[0].n_modes:
        raise ValueError(f'modes is {modes}, but {path} holds {runs[0].n_modes}')
    n_modes = modes or runs[0].n_modes
    # The digest of the training runs says which dataset it is, whatever split is read.
    names = [n for n in ('metadata.json', 'train.tfrecord') if os.path.exists(f'{path}/{n}')]
    n_rigid = 0
    if nodes == 'modes_and_rigid':
        trained_on = [] if split == 'train' else dataset.read_split(path, 'train')
        n_rigid = min(run.n_rigid for run in [*runs, *trained_on])
        if not n_rigid:
            raise ValueError(
                f'{path}: {split} has runs without rigid particles; take --nodes=modes'
            )
    n_frames = min(run.n_frames for run in runs)
    positions = []
    for run in runs:
        # Blades of another tilt have more particles; the lowest ones touch the soil in every run.
        height = run.position[0, : run.n_rigid, up]
        rigid = np.sort(np.argsort(height, kind='stable')[:n_rigid])
        kept = [*rigid, *range(run.n_rigid, run.n_rigid + n_modes)]
        positions.append(run.position[:n_frames, kept].astype(np.float64))
    position = np.stack(positions)  # [S, T, V, D]
    velocity = np.diff(position, axis=1)
    features = np.concatenate([position[:, 1:], velocity], -1).transpose(0, 2, 1, 3)
    return NriData(
        features.astype(np.float32),
        None,
        tuple(f'rigid_{i}' for i in range(n_rigid)) + tuple(f'mode_{k}' for k in range(n_modes)),
        False,
        _digest(os.path.join(path, n) for n in names),
        f'{path}: {split}',
    )


def _read_array(path, n_axes):
    array = files.read_npy(path)
    if array.dtype.kind not in 'fiub':
        raise ValueError(f'{path}: not a .npy array of numbers')
    if array.ndim != n_axes or 0 in array.shape:
        raise ValueError(
            f'{path}: has shape {array.shape}, an array of {n_axes} axes, none empty, was expected'
        )
    # Also what float32, in which the networks count, cannot hold.
    bad = np.count_nonzero(~(np.abs(array) <= np.finfo(np.float32).max))
    if bad:
        raise ValueError(f'{path}: holds {bad} NaN, infinite or too large values')
    return array


def write_array(path: str, array: np.ndarray) -> None:
    """Writes a .npy file, whole or not at all."""

    def write(temporary):
        with open(temporary, 'wb') as file:  # by handle: numpy appends .npy to a name
            np.save(file, array)

    files.write_atomically(path, write)


def _load_kipf(path, split):
    endings = [n[3:] for n in sorted(os.listdir(path)) if re.fullmatch(rf'loc_{split}_?.*\.npy', n)]
    if not endings:
        raise FileNotFoundError(
            f'{path}: holds neither metadata.json (a dataset of this project) nor '
            f'loc_{split}_*.npy (data of Kipf et al., see nri.simulate)'
        )
    if len(endings) > 1:
        raise ValueError(
            f'{path}: holds {" and ".join("loc" + e for e in endings)}; one system per folder'
        )
    names = {k: os.path.join(path, k + endings[0]) for k in ('loc', 'vel', 'edges')}
    for name in names.values():
        if not os.path.exists(name):
            raise FileNotFoundError(f'{name}: no such file, but loc{endings[0]} is there')
    position, velocity = _read_array(names['loc'], 4), _read_array(names['vel'], 4)
    if position.shape != velocity.shape:
        raise ValueError(
            f'{names["loc"]} has shape {position.shape}, {names["vel"]} {velocity.shape}: '
            f'they are not of the same runs'
        )
    features = np.concatenate([position, velocity], axis=2).transpose(0, 3, 1, 2)
    n_run, n_node = features.shape[:2]
    relations = _read_array(names['edges'], 3)
    if relations.shape != (n_run, n_node, n_node):
        raise ValueError(
            f'{names["edges"]} has shape {relations.shape}, but there are {n_run} runs of '
            f'{n_node} nodes: ({n_run}, {n_node}, {n_node}) was expected'
        )
    return NriData(
        np.ascontiguousarray(features, np.float32),
        edge_types(relations, names['edges']),
        tuple(f'node_{i}' for i in range(n_node)),
        True,
        _digest(names.values()),
        f'{path}: {split}',
    )


def edge_types(relations: np.ndarray, source: str = 'relations') -> np.ndarray:
    """Edge types of all pairs, int32 [S, V (V - 1)], from [S, V, V] matrices with Kipf's values: 0
    and 1 of springs, -1 and 1 of charges, the lower one is type 0. ValueError: other values."""
    off = ~np.eye(relations.shape[1], dtype=bool)
    values = relations[:, off]
    if not (np.isin(values, (0, 1)).all() or np.isin(values, (-1, 1)).all()):
        raise ValueError(
            f'{source}: relations must be 0 and 1, or -1 and 1; found values from '
            f'{values.min():.6g} to {values.max():.6g}'
        )
    return (values > 0).astype(np.int32)


def normalization(data: NriData) -> tuple[np.ndarray, np.ndarray]:
    """Offset and scale, float32 [1 or V, F], with which (features - offset) / scale of a split fill
    [-1, 1] (Kipf et al. 2018).

    One scale for positions and one for velocities (all axes share it: a still axis is not blown
    up), over all nodes, or for each node where their scales differ."""
    n_run, n_node, n_frame, n_feature = data.features.shape
    halves = data.features.astype(np.float64).reshape(n_run, n_node, n_frame, 2, n_feature // 2)
    axes = (0, 1, 2, 4) if data.same_scale else (0, 2)
    low, high = halves.min(axis=axes, keepdims=True), halves.max(axis=axes, keepdims=True)
    half = 0.5 * (high - low).max(axis=4, keepdims=True)
    shape = (1 if data.same_scale else n_node, 2, n_feature // 2)
    offset, scale = (
        np.broadcast_to(x[0, :, 0], shape).reshape(-1, n_feature).astype(np.float32)
        for x in (0.5 * (low + high), np.where(half > 0, half, 1.0))
    )
    return offset, scale
