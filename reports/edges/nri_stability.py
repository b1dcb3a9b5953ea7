"""How stable is the graph that NRI finds? The same training from several seeds, compared.

Examples:
    python -m reports nri_stability --data_path=datasets/excavation \\
        --work_path=/tmp/nri_excavation --output_path=docs/edges/excavation_nri.json

    # other settings of `NriConfig`
    python -m reports nri_stability --data_path=datasets/excavation --set=modes=8 --set=epochs=20 \\
        --work_path=/tmp/nri_8 --output_path=/tmp/nri_8.json

Resumes where it was stopped; a picture of the graphs lies beside the JSON, which holds P(edge) of
every seed, mean over the training runs.
"""

import dataclasses
import itertools
import os

import numpy as np
from absl import flags

from learning_to_simulate.command import import_tensorflow
from learning_to_simulate.command import settings as given_settings
from learning_to_simulate.subspace import edge_lists
from nri import data as nri_data
from nri import export_edges
from nri.config import NriConfig
from pca_tools import files, workers
from reports import markdown, record

THRESHOLD = 0.6  # an edge has a probability above it
# What differs from `NriConfig`; the learning rate stays unless --set gives a decay_start.
SETTINGS: dict = {'epochs': 8, 'hidden': 32, 'stride': 2, 'batch_size': 16, 'learning_rate': 1e-3,
            'decay_epochs': 10}  # fmt: skip


def train_seed(data_path: str, model_path: str, config: NriConfig) -> dict:
    """Trains NRI from one seed, or finishes it, and returns the row of the seed: P(edge) [V, V]
    ([receiver][sender], null on the diagonal), spread over the runs, edges above the threshold,
    test loss and status, loss on valid after each epoch."""
    from nri import training
    from nri.model import load_model

    metrics = training.train(data_path, model_path, config)
    history = files.read_json(os.path.join(model_path, training.HISTORY_FILE))
    model = load_model(model_path)
    data = nri_data.load(data_path, 'train', config.nodes, config.modes)
    posterior = export_edges.edge_posterior(model, data.features)
    p = posterior.mean(axis=0)
    return {
        'seed': config.seed,
        'weights': model.digest,
        'node_names': list(model.node_names),
        'edges': int((p > THRESHOLD).sum()),
        'status': metrics['test']['status'],
        'test_loss': metrics['test']['loss'],
        'seconds': metrics['seconds'],
        'valid_losses': [round(row['loss'], 3) for row in history],
        **export_edges.spread(posterior, THRESHOLD),
        'probabilities': [[None if np.isnan(x) else round(float(x), 5) for x in r] for r in p],
    }


def train_job(job: tuple) -> dict:
    """`train_seed` as a task of a worker, on one thread."""
    import_tensorflow(1)
    return train_seed(*job)


def matrices(rows: list[dict]) -> np.ndarray:
    """P(edge) of all seeds: float64 [seeds, V, V], NaN on the diagonal."""
    return np.array([row['probabilities'] for row in rows], np.float64)


def compare(rows: list[dict]) -> dict:
    """Agreement of the seeds (rows of `train_seed`), each beside what unrelated graphs of the same
    density would have (`jaccard_by_chance`, `agreement_by_chance`): mean and range over pairs of
    seeds of `jaccard` (edges in both over edges in either), of `agreement` (share of node pairs on
    which both say the same) and of `correlation` of the probabilities; numbers of edges."""
    p = matrices(rows)[:, ~np.eye(len(rows[0]['node_names']), dtype=bool)]
    found = p > THRESHOLD
    by_chance: list = []
    values: dict = {'jaccard': [], 'agreement': [], 'correlation': []}
    for a, b in itertools.combinations(range(len(rows)), 2):
        both, either = (found[a] & found[b]).mean(), (found[a] | found[b]).mean()
        if either:
            values['jaccard'].append(both / either)
        values['agreement'].append((found[a] == found[b]).mean())
        if p[a].std() > 0 and p[b].std() > 0:
            values['correlation'].append(np.corrcoef(p[a], p[b])[0, 1])
        x, y = found[a].mean(), found[b].mean()  # two unrelated graphs of these densities
        either = x + y - x * y
        by_chance.append((x * y / either if either else 1.0, x * y + (1 - x) * (1 - y)))
    jaccard, same = np.mean(by_chance, axis=0)
    return {
        name: {'mean': float(np.mean(v)), 'min': float(min(v)), 'max': float(max(v))} if v else None
        for name, v in values.items()
    } | {
        'jaccard_by_chance': float(jaccard),
        'agreement_by_chance': float(same),
        'in_all_seeds': int(found.all(axis=0).sum()),
        'in_any_seed': int(found.any(axis=0).sum()),
        'pairs_of_nodes': int(p.shape[1]),
    }


def agreement(*paths: str) -> str:
    """How far the seeds of NRI agree: a row for each stored result."""
    header = ('', 'edges in the seeds', 'Jaccard (by chance)', 'same answer (by chance)',
              'in all seeds', 'in any seed')  # fmt: skip
    lines = []
    for path in paths:
        result = files.read_json(path)
        found = result['compared']
        beside_chance = [
            f'{markdown.cell(found[key]["mean"])} ({markdown.cell(found[f"{key}_by_chance"])})'
            for key in ('jaccard', 'agreement')
        ]
        lines.append(
            (os.path.basename(path).removesuffix('_nri.json'),
             markdown.mean([row['edges'] for row in result['seeds']]), *beside_chance,
             found['in_all_seeds'], found['in_any_seed'])
        )  # fmt: skip
    return markdown.table(header, lines)


def draw(path: str, result: dict) -> None:
    """Draws P(edge) of every seed and their mean, senders x receivers, as PNG."""
    rows, p = result['seeds'], matrices(result['seeds'])
    titles = [f'seed {r["seed"]}: {r["edges"]} edges, {r["entropy_bits"]:.2f} bits' for r in rows]
    panels = zip([*titles, 'mean over seeds'], [*p, p.mean(axis=0)], strict=True)
    names = rows[0]['node_names']
    figure, _ = export_edges.show_matrices([(*panel, names) for panel in panels])
    export_edges.save(path, figure)


def define_flags() -> None:
    flags.DEFINE_string('data_path', None, 'Dataset folder.', required=True)
    flags.DEFINE_string('work_path', None, 'Folder for the models.', required=True)
    flags.DEFINE_string('output_path', None, 'JSON file of the result.', required=True)
    flags.DEFINE_integer('seeds', 5, 'Trainings to compare.', 2)
    flags.DEFINE_integer('num_processes', 1, 'Seeds trained at a time, without a cluster.', 1)
    flags.DEFINE_string('cluster', '', 'Where that is done: local:4, slurm:64, tcp://host:port.')
    flags.DEFINE_multi_string('set', [], f'NAME=VALUE of `NriConfig`; else {SETTINGS}.')


def main(v) -> None:
    types: dict = {f.name: f.type for f in dataclasses.fields(NriConfig) if f.name != 'seed'}
    types['no_edge_prior'] = float
    settings = SETTINGS | given_settings(v.set, types)
    settings = {'decay_start': settings['epochs']} | settings
    jobs = []
    for seed in range(v.seeds):
        config = NriConfig(**settings, seed=seed)
        model_path = os.path.abspath(os.path.join(v.work_path, f'seed_{seed}'))
        jobs.append((os.path.abspath(v.data_path), model_path, config))
    with workers.start(v.cluster, v.num_processes) as crew:
        outcomes = sorted(crew.run(train_job, jobs), key=lambda outcome: outcome.index)
    if failed := [f'seed {o.index}: {o.error}' for o in outcomes if o.error is not None]:
        raise ValueError('; '.join(failed))
    rows = [outcome.value for outcome in outcomes]
    result = record.provenance(1) | {
        'digests': edge_lists.data_digests(v.data_path),
        'settings': settings | {'threshold': THRESHOLD},
        'compared': compare(rows),
        'seeds': rows,
    }
    os.makedirs(os.path.dirname(os.path.abspath(v.output_path)), exist_ok=True)
    files.write_json(v.output_path, result)
    stem = os.path.splitext(v.output_path)[0]
    draw(f'{stem}.png', result)
    for name, value in result['compared'].items():
        print(f'{name:22s} {value}')
