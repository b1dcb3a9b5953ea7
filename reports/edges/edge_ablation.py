"""What the edges between modes are worth: one graph network on many lists of edges, judged by the
protocol.

Examples:
    # the graphs of NRI first (a list for each seed), then the comparison
    python -m reports nri_stability --data_path=datasets/excavation --set=modes=8 \\
        --work_path=/tmp/nri --output_path=nri.json
    python -m reports edges --data_path=datasets/excavation --modes=8 --nri_path=nri.json \\
        --work_path=/tmp/edges --output_path=/tmp/edges.json

Every row is the preset `pcg` with another `adjacency` and nothing else. The lists that this
report makes (`<work_path>/lists/<variant>_<seed>.json`) have no self-edges where they have a number
of edges: NRI has none, and so they differ in their choice of pairs alone.
"""

import os

import numpy as np
from absl import flags

from learning_to_simulate import connectivity_utils, presets, reading_utils
from learning_to_simulate.subspace import edge_lists
from pca_tools import dataset, files
from reports.protocol import judge, report

# Lists that differ from seed to seed; the others depend on the data alone.
OF_SEED = ('random', 'NRI')
NO_LIST: dict[str, dict] = {
    'fully_connected': {'adjacency': 'fully_connected'},
    'gates': {'gate_weight': 2.0},
}


def masks_of(velocities, keep: int, seed: int, nri_rows=None) -> dict:
    """The mode block of every variant that is a list: variant -> mask, bool [r, r]; scores, float
    [r, r] in [0, 1], what it was chosen by or the mask itself; method, of `edge_lists.METHODS`.

    Of velocities [S, T, r, D] of the modes on the training runs; lists that have a number of edges
    keep so many. NRI's list is of its training from the same seed, of `nri_rows` (`seeds` of the
    JSON of `nri_stability`, or None); ValueError if its nodes are not the modes, or it has none
    from that seed.
    """
    r = velocities.shape[2]
    nobody, own = np.zeros((r, r), bool), np.eye(r, dtype=bool)
    correlation = connectivity_utils.mode_correlations(velocities)
    np.fill_diagonal(correlation, np.nan)
    score = np.random.default_rng([seed, r]).random((r, r))
    np.fill_diagonal(score, np.nan)

    def kept(scores):
        return edge_lists.select(scores, keep=keep)

    found = {
        'none': (nobody, None, 'fixed'),
        'self': (own, None, 'fixed'),
        'all': (~nobody, None, 'fixed'),
        'correlation': (kept(correlation), correlation, 'correlation'),
        'correlation_and_self': (kept(correlation) | own, correlation, 'correlation'),
        'random': (kept(score), None, 'fixed'),
    }
    if nri_rows is not None:
        row = next((row for row in nri_rows if row['seed'] == seed), None)
        if row is None or row['node_names'] != list(edge_lists.mode_names(r)):
            raise ValueError(f'NRI has no training over {r} modes from seed {seed}')
        probabilities = np.array(row['probabilities'], np.float64)
        found['NRI'] = kept(probabilities), probabilities, 'nri'
    return {
        name: (mask, mask.astype(float) if scores is None else scores, method)
        for name, (mask, scores, method) in found.items()
    }


def write_lists(folder: str, data_path: str, modes: int, keep: int, seeds: int, nri_rows) -> list:
    """Writes `<variant>_<seed>.json` of all variants that are lists; returns their names, raises as
    `masks_of`."""
    metadata = dataset.read_metadata(data_path)
    groups = reading_utils.read_groups(data_path, 'train', metadata, modes=modes)
    r = groups[0].position.shape[2] - groups[0].n_rigid
    velocities = np.concatenate([g.velocity[:, :, g.n_rigid :] for g in groups])
    os.makedirs(folder, exist_ok=True)
    names: dict[str, None] = {}
    for seed in range(seeds):
        for name, (mask, scores, method) in masks_of(velocities, keep, seed, nri_rows).items():
            names[name] = None
            edges = edge_lists.EdgeList(
                mask, edge_lists.mode_names(r), scores, method, None,
                {'model': None} | edge_lists.data_digests(data_path),
                edge_lists.degeneracy(mask), {'source': f'reports edges, {name}, seed {seed}'},
            )  # fmt: skip
            edge_lists.write(os.path.join(folder, f'{name}_{seed}.json'), edges)
    return list(names)


def nri_rows_of(path: str | None, data_path: str):
    """The seeds of `nri_stability` on the same data, None without a path; ValueError for the JSON
    of another report, or of another dataset."""
    if not path:
        return None
    values = files.read_json(path)
    if not isinstance(values, dict) or 'seeds' not in values:
        raise ValueError(f'{path}: not the result of reports nri_stability')
    if values.get('digests') != edge_lists.data_digests(data_path):
        raise ValueError(f'{path}: NRI was trained on another dataset than {data_path}')
    return values['seeds']


def define_flags() -> None:
    flags.DEFINE_string('data_path', None, 'Dataset folder.', required=True)
    flags.DEFINE_string('nri_path', None, 'JSON of reports nri_stability; none: no NRI row.')
    flags.DEFINE_string('work_path', None, 'Folder for lists and trainings.', required=True)
    flags.DEFINE_string('output_path', None, "The protocol's JSON.", required=True)
    flags.DEFINE_integer('modes', 0, 'How many of the modes, the first ones; 0: all.', 0)
    flags.DEFINE_integer('num_seeds', 3, 'Trainings of each row.', 1)
    flags.DEFINE_integer('keep', 20, 'Mode edges of the lists that have a number.', 1)
    flags.DEFINE_integer('num_processes', 1, 'Models trained at a time.', 1)


def main(v) -> None:
    lists, models = (os.path.abspath(os.path.join(v.work_path, n)) for n in ('lists', 'models'))
    rows = nri_rows_of(v.nri_path, v.data_path)
    written = write_lists(lists, v.data_path, v.modes, v.keep, v.num_seeds, rows)
    jobs, methods = [], {}
    for name in [*NO_LIST, *written]:
        methods[name] = [os.path.join(models, f'{name}_{seed}') for seed in range(v.num_seeds)]
        for seed, path in enumerate(methods[name]):
            file = f'{lists}/{name}_{seed if name in OF_SEED else 0}.json'
            setting = NO_LIST.get(name, {'adjacency': file})
            config = presets.make_config('pcg', **setting, modes=v.modes, seed=seed)
            jobs.append((v.data_path, path, config, None))
    judge.make_all(jobs, v.num_processes)
    report.write(methods, v)
