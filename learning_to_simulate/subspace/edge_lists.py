"""`EdgeList`: edges between named nodes, found by a method, in a file: `edges.json`.

One schema for every method (Neural Relational Inference, learned gates, correlation); docs/data.md
explains its fields. A list belongs to the subspace it was found in: names and digests are held
against the dataset before an edge is used.
"""

import dataclasses
import os
from typing import Any, NamedTuple

import numpy as np

from learning_to_simulate import checkpoints, connectivity_utils
from pca_tools import files

FILE_NAME = 'edges.json'
SCHEMA_VERSION = 1
METHODS = ('nri', 'gates', 'correlation', 'fixed')
CONVENTION = (
    'edge k goes from senders[k] to receivers[k]; indices count node_names; edges are sorted by '
    'receiver, then sender; probabilities are [receiver][sender], null where the method has none '
    '(NRI: self-edges)'
)
# A damaged file must not ask for the memory of a matrix of millions.
MAX_NODES = 1000
# Files of a dataset that say which modes the edges join.
DATA_FILES = ('subspace.npz', 'train.tfrecord')


def mode_names(n_modes: int) -> tuple[str, ...]:
    """Node names of the r modes, in the order of the subspace."""
    return tuple(f'mode_{k}' for k in range(n_modes))


def data_digests(data_path: str) -> dict[str, str]:
    """sha256 of those `DATA_FILES` that a dataset folder has."""
    return checkpoints.digests(data_path, DATA_FILES)


@dataclasses.dataclass(frozen=True)
class EdgeList:
    """Directed edges between V named nodes.

    Raises:
      ValueError: on construction, for a field of the wrong kind, or a graph that is empty or
        saturated without saying so.
    """

    mask: np.ndarray  # bool [V, V], entry [receiver, sender]
    node_names: tuple[str, ...]  # V different names
    # float64 [V, V] of every pair, entry [receiver, sender]; NaN where the method has none.
    probabilities: np.ndarray
    method: str  # one of `METHODS`
    threshold: float | None  # edges lie above it; None where their number was given
    digests: dict[str, str | None]  # sha256 of `model` and of the `DATA_FILES` it was found on
    degenerate: str | None = None  # 'empty' or 'saturated' where that was allowed
    report: dict[str, Any] = dataclasses.field(default_factory=dict)  # of the method; free JSON

    def __post_init__(self):
        n = len(self.node_names)
        if n == 0 or len(set(self.node_names)) != n:
            raise ValueError(f'node_names must be different names, got {list(self.node_names)}')
        for name in ('mask', 'probabilities'):
            if getattr(self, name).shape != (n, n):
                raise ValueError(f'{name} is {getattr(self, name).shape} for {n} nodes')
        known = self.probabilities[~np.isnan(self.probabilities)]
        if ((known < 0) | (known > 1)).any():
            raise ValueError(
                f'probabilities reach from {known.min():.4g} to {known.max():.4g}, must lie in '
                f'[0, 1]'
            )
        if self.method not in METHODS:
            raise ValueError(f'method is {self.method!r}, must be one of {METHODS}')
        if self.threshold is not None and not 0 <= self.threshold <= 1:
            raise ValueError(f'threshold is {self.threshold!r}, must lie in [0, 1]')
        if not all(v is None or isinstance(v, str) for v in self.digests.values()):
            raise ValueError(f'digests must be texts, got {self.digests}')
        if self.degenerate != (found := degeneracy(self.mask)) and found:
            raise ValueError(
                f'the graph is {found} ({self.mask.sum()} edges between {n} nodes): every model '
                f'would ignore, or need no, such a list'
            )

    @property
    def n_edge(self) -> int:
        return int(self.mask.sum())

    def mask_for(self, names) -> np.ndarray:
        """bool mask over some of the nodes, in the order of `names`; raises ValueError if a name is
        missing, or the list has further modes: then it was found in another subspace."""
        missing = [name for name in names if name not in self.node_names]
        extra = [n for n in self.node_names if n.startswith('mode_') and n not in names]
        if missing or extra:
            raise ValueError(
                f'the edges join {_short(self.node_names)}, but the nodes are {_short(names)}'
            )
        order = [self.node_names.index(name) for name in names]
        return self.mask[np.ix_(order, order)]

    def check_data(self, data_path: str) -> None:
        """Raises ValueError if the list was found on another dataset than that of a folder.

        The subspace decides where both have one: modes of the same subspace are the same nodes,
        whichever runs the list was found on.
        """
        here = data_digests(data_path)
        for name in DATA_FILES:
            if name in here and self.digests.get(name):
                if here[name] == self.digests[name]:
                    return
                raise ValueError(
                    f'the edges were found on another dataset: {name} there has sha256 '
                    f'{self.digests[name][:12]}..., in {data_path} {here[name][:12]}...; find the '
                    f'edges anew, or give their .npy mask to use them all the same'
                )
        raise ValueError(
            f'nothing says that the edges belong to {data_path}: no digest of {DATA_FILES} in both'
        )


def degeneracy(mask: np.ndarray) -> str | None:
    """'empty' without an edge between two different nodes, 'saturated' with all of them."""
    off_diagonal = mask[~np.eye(len(mask), dtype=bool)]
    if not off_diagonal.any():
        return 'empty'
    return 'saturated' if off_diagonal.all() else None


def select(probabilities, *, threshold=None, keep=None) -> np.ndarray:
    """The edges that a probability matrix gives, bool [V, V].

    Args:
      probabilities: [V, V], entry [receiver, sender]; NaN where there is no edge, on the diagonal
        of a method without self-edges.
      threshold: keeps pairs with a probability above it.
      keep: instead, keeps the `keep` most probable edges (self-edges counted; ties go to the lower
        receiver, then sender).

    Raises:
      ValueError: unless exactly one of threshold and keep is given, or `keep` cannot be met.
    """
    if (threshold is None) == (keep is None):
        raise ValueError('give either a threshold or the number of edges to keep')
    probabilities = np.asarray(probabilities, np.float64)
    if keep is None:
        return probabilities > threshold  # false for NaN as well
    possible = int((~np.isnan(probabilities)).sum())
    if not 0 <= keep <= possible:
        raise ValueError(f'{keep} edges to keep (mode_edges), must lie in [0, {possible}]')
    mask = np.zeros(probabilities.size, bool)
    mask[np.argsort(-probabilities, axis=None, kind='stable')[:keep]] = True  # NaN comes last
    return mask.reshape(probabilities.shape)


def write(path: str, edges: EdgeList) -> None:
    """Writes `edges.json` whole or not at all; the folder must exist."""
    receivers, senders = np.nonzero(edges.mask)
    rows = [[None if np.isnan(p) else round(float(p), 6) for p in q] for q in edges.probabilities]
    as_they_are = ('method', 'threshold', 'degenerate', 'digests', 'report')
    files.write_json(
        path,
        {
            'schema_version': SCHEMA_VERSION,
            'convention': CONVENTION,
            'node_names': list(edges.node_names),
            'senders': senders.tolist(),
            'receivers': receivers.tolist(),
            **{name: getattr(edges, name) for name in as_they_are},
            'probabilities': rows,
        },
    )


def read(path: str) -> EdgeList:
    """Reads and checks `edges.json`; ValueError for a missing or damaged file, another kind or
    version, a field that is missing or out of range, an edge listed twice or outside the nodes, an
    empty or saturated graph that does not say so."""
    if not os.path.isfile(path):
        raise ValueError(f'{path}: no such edge file')
    values = files.read_json(path)
    if not isinstance(values, dict) or values.get('schema_version') != SCHEMA_VERSION:
        raise ValueError(f'{path}: not an edge list of schema version {SCHEMA_VERSION}')
    try:
        if values['convention'] != CONVENTION:
            raise ValueError(f'convention is {values["convention"]!r}, known is {CONVENTION!r}')
        names = tuple(map(str, values['node_names']))
        if len(names) > MAX_NODES:
            raise ValueError(f'{len(names)} nodes are more than the limit of {MAX_NODES}')
        return EdgeList(
            mask=_mask_of(values['senders'], values['receivers'], len(names)),
            node_names=names,
            probabilities=np.array(values['probabilities'], np.float64),
            method=values['method'],
            threshold=values['threshold'],
            digests=dict(values['digests']),
            degenerate=values['degenerate'],
            report=dict(values['report']),
        )
    except KeyError as error:
        raise ValueError(f'{path}: not an edge list, {error} is missing') from error
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f'{path}: {error}') from error


def read_mask(path: str) -> np.ndarray:
    """Reads a bare adjacency mask: `.npy`, bool [V, V], entry [receiver, sender]; ValueError for a
    missing or foreign file, or a mask that is not square."""
    if not os.path.isfile(path):
        raise ValueError(f'{path}: no such edge file')
    mask = files.read_npy(path)
    is_square = mask.ndim == 2 and mask.shape[0] == mask.shape[1]
    if not is_square or mask.dtype.kind not in 'biuf' or not np.isin(mask, (0, 1)).all():
        raise ValueError(
            f'{path}: a mask must be a square array of 0 and 1, got shape '
            f'{mask.shape} of {mask.dtype}'
        )
    return mask.astype(bool)


class ModeEdges(NamedTuple):
    """The part of the graph that a config leaves to data."""

    mode_mask: np.ndarray | None  # bool [r, r], to be completed by Algorithm 2
    loaded_mask: np.ndarray | None  # bool [V, V], used as it is
    source: str  # where the edges come from, for the log and config.json


def choose(config, data_path: str, n_modes: int, velocities) -> ModeEdges:
    """The edges that a `TrainConfig` asks for on a dataset with r modes.

    Args:
      config: its adjacency is 'fully_connected' or 'none'; 'algorithm2' (all mode edges where gates
        are learned, else `edges.json` of the dataset, else ranked by correlation); 'correlation';
        'random'; or a file, `.json` or `.npy`.
      data_path: dataset folder.
      velocities: of the modes on the training runs, as for `mode_correlations`.

    Raises:
      ValueError: a file that is damaged, foreign or of another dataset, or a wish for a number of
        ranked edges where a file gives them.
    """
    kind, keep = config.adjacency, config.mode_edges
    if kind in ('fully_connected', 'none'):
        return ModeEdges(None, None, kind)
    if config.gate_weight > 0:
        return ModeEdges(np.ones((n_modes, n_modes), bool), None, 'gates, not yet closed')
    shipped, name = os.path.join(data_path, FILE_NAME), kind
    if kind == 'algorithm2' and os.path.exists(shipped):
        if keep != type(config).mode_edges:
            raise ValueError(
                f'mode_edges is {keep}, but {shipped} gives the edges: add '
                f'--adjacency=correlation to rank them, or leave mode_edges out'
            )
        kind, name = shipped, f'{FILE_NAME} of the dataset'
    if kind in ('algorithm2', 'correlation', 'random'):
        if kind == 'random':  # what a list that was found is to be compared with
            rng = np.random.default_rng([config.seed, n_modes])
            score, source = rng.random((n_modes, n_modes)), f'by lot, seed {config.seed}'
        else:
            score = connectivity_utils.mode_correlations(velocities)
            source = 'ranked by lagged correlation'
        np.fill_diagonal(score, np.inf)  # self-edges first
        return ModeEdges(select(score, keep=keep), None, f'{keep} {source}')
    if kind.endswith('.npy'):
        mask = read_mask(kind)
        source = f'{name} (sha256 {files.sha256_of_file(kind)[:12]})'
        return ModeEdges(*((mask, None) if len(mask) == n_modes else (None, mask)), source)  # type: ignore[call-arg]
    edges = read(kind)
    try:
        edges.check_data(data_path)
        mask = edges.mask_for(mode_names(n_modes))
    except ValueError as error:
        raise ValueError(f'{kind}: {error}') from error
    digest = files.sha256_of_file(kind)[:12]
    return ModeEdges(mask, None, f'{name} (method {edges.method}, sha256 {digest})')


def _mask_of(senders, receivers, n_node: int) -> np.ndarray:
    """bool [V, V] of the edges of a JSON file."""
    for ends in (senders, receivers):
        if not isinstance(ends, list) or not all(type(end) is int for end in ends):
            raise ValueError('senders and receivers must be lists of whole numbers')
        if ends and not 0 <= min(ends) <= max(ends) < n_node:
            raise ValueError(
                f'edge ends reach from {min(ends)} to {max(ends)}, but there are {n_node} nodes'
            )
    if len(senders) != len(receivers):
        raise ValueError(
            f'{len(senders)} senders and {len(receivers)} receivers must be two equal lists'
        )
    mask = np.zeros((n_node, n_node), bool)
    mask[receivers, senders] = True
    if mask.sum() != len(senders):
        raise ValueError('an edge is listed twice')
    return mask


def _short(names) -> str:
    """A list of names, cut where it grows long."""
    names = list(names)
    return f'{len(names)} nodes {names}' if len(names) < 5 else f'{len(names)} nodes {names[:2]}...'
