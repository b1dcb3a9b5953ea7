"""Proof that NRI finds the edges: simulates particles, trains without labels, measures.

Examples:
  python -m reports nri_proof --system=springs --n_objects=5 --work_path=/tmp/nri_proof
  python -m reports nri_proof --system=springs --n_objects=5 --work_path=/tmp/nri_test \\
      --model_path=MODEL
  python -m reports nri_proof --central --system=charged --n_objects=5 --work_path=/tmp/nri_proof

Writes docs/nri_<system><n>.json and .png: edge accuracy on the test split, beside Kipf's, and the
accuracy on the validation split against time. The true edges are used to measure, never to train.
The same command again resumes. A model that was trained elsewhere, as on a GPU, is only judged
(`--model_path`) and written to docs/nri_<system><n>_gpu.json. With `--central` the edges follow
from the decoder (`nri/central.py`): docs/nri_<system><n>_central.json.
"""

import dataclasses
import glob
import os

from absl import flags
from matplotlib.figure import Figure

from learning_to_simulate import command
from nri import simulate
from nri.config import NriConfig
from pca_tools import files
from reports import markdown, record

# Unsupervised edge accuracy, Kipf et al. 2018, table 1.
PUBLISHED = {
    ('springs', 5): 0.999,
    ('springs', 10): 0.984,
    ('charged', 5): 0.821,
    ('charged', 10): 0.708,
}
# A constant, high rate until the edges are found, then a late decay; small batches.
RECIPE = {'hidden': 64, 'batch_size': 64, 'learning_rate': 1e-3}
# Charges attract or repel each other: both types send messages, where of springs the first one
# stands for no spring (`skip_first`); they may know that forces are mutual (`symmetric`).
OF_SYSTEM = {'charged': {'symmetric': True, 'skip_first': False}}
# Training runs and what differs from both: up to two hours of one core each. Ten springs may know
# that forces are mutual, too.
BUDGETS = {
    ('springs', 5): (50000, {'epochs': 180, 'decay_start': 100, 'decay_epochs': 10}),
    ('charged', 5): (50000, {'epochs': 40, 'decay_start': 26, 'decay_epochs': 4}),
    ('springs', 10): (
        50000, {'symmetric': True, 'epochs': 84, 'decay_start': 50, 'decay_epochs': 6},
    ),
}  # fmt: skip
# Of `--central`, for all systems: four minutes of a core with five objects, 20 with ten.
CENTRAL = 8000, {
    'central': True, 'learning_rate': 2e-3, 'segment': 16, 'epochs': 16,
    'decay_start': 10, 'decay_epochs': 2,
}  # fmt: skip
CURVE = ('epoch', 'seconds', 'train_loss', 'loss', 'accuracy')  # of a history of training
OTHERS = 20000, {'epochs': 60, 'decay_start': 42, 'decay_epochs': 3}


def settings_of(system, n_objects, central=False):
    """Runs of each split and `NriConfig` of V objects of a system."""
    n_train, budget = CENTRAL if central else BUDGETS.get((system, n_objects), OTHERS)
    counts = {'train': n_train, 'valid': 2000 if central else 5000, 'test': 10000}
    return counts, NriConfig(**RECIPE | OF_SYSTEM.get(system, {}) | budget)


def run(system, n_objects, work_path, counts, config, model_path=None):
    """Simulates `counts` (split -> runs), trains or resumes, and judges; or judges the model of a
    folder, with history.json and, in metrics.json, what it was `trained_on`. Returns what the JSON
    file holds."""
    from nri import data, losses, model, training

    name = f'{system}{n_objects}'
    work_path = os.path.join(work_path, 'central' if config.central else '')
    data_path = os.path.join(work_path, f'{"test" if model_path else "data"}_{name}')
    made_of = {'test': counts['test']} if model_path else counts
    if not os.path.exists(os.path.join(data_path, f'simulation_{name}.json')):
        made = simulate.SYSTEMS[system](n_objects=n_objects)
        sample_every = round(0.1 / made.dt)
        how = 50 * sample_every, sample_every, 42
        for left in glob.glob(os.path.join(glob.escape(data_path), f'*_{name}.npy')):
            os.remove(left)  # of a simulation that was killed
        simulate.write_dataset(made, system, made_of, *how, data_path)
    if model_path:
        trained = model.load_model(model_path)
        config, test = trained.config, data.load(data_path, 'test')
        windows = test.features[:, :, : config.span : config.stride]
        found = trained.window_probabilities(windows).argmax(axis=-1)
        accuracy, _ = losses.edge_accuracy(found, test.edges, config.edge_types)
        metrics = files.read_json(os.path.join(model_path, training.METRICS_FILE))
        metrics |= {'test': {'accuracy': accuracy}}
    else:
        model_path = os.path.join(work_path, f'model_{name}_{config.seed}')
        metrics = training.train(data_path, model_path, config)
    history = files.read_json(os.path.join(model_path, training.HISTORY_FILE))
    return {
        'system': system,
        'n_objects': n_objects,
        'runs': counts,
        'trained_on': metrics.get('trained_on', 'one core'),
        'settings': dataclasses.asdict(config),
        'seconds': metrics['seconds'],
        'seconds_per_epoch': metrics['epoch_seconds'],
        'kept_epoch': metrics['best_epoch'],
        'test_accuracy': metrics['test']['accuracy'],
        'published_accuracy': PUBLISHED.get((system, n_objects)),
        'curve': [{name: row[name] for name in CURVE if name in row} for row in history],
    }


def table(*paths: str) -> str:
    """Edge accuracy of stored results beside Kipf's."""
    header = ('system', 'objects', 'edges from', 'mutual forces', 'turned', 'width', 'epochs',
              'minutes', 'on', 'edges right', 'Kipf et al.')  # fmt: skip
    rows = [
        (r['system'], r['n_objects'], 'decoder' if r['settings'].get('central') else 'encoder',
         *('yes' if r['settings'].get(k) else 'no' for k in ('symmetric', 'isotropic')),
         r['settings']['hidden'], r['settings']['epochs'], round(r['seconds'] / 60),
         r.get('trained_on', 'one core'),
         ', '.join(f'{x:.2%}' for x in [r['test_accuracy'], *r.get('other_seeds', [])]),
         f'{r["published_accuracy"]:.1%}')
        for r in map(files.read_json, paths)
    ]  # fmt: skip
    return markdown.table(header, rows)


def draw(result, path):
    """Share of wrong edges against minutes, on a logarithmic scale."""
    figure = Figure(figsize=(6, 3.6), layout='constrained')
    axes = figure.subplots()
    minutes = [row['seconds'] / 60 for row in result['curve']]
    axes.semilogy(minutes, [1 - row['accuracy'] for row in result['curve']], label='validation')
    right, published = result['test_accuracy'], result['published_accuracy']
    axes.axhline(1 - right, color='C1', label=f'test: {right:.2%} right')
    if published:
        label = f'Kipf et al. 2018: {published:.1%}'
        axes.axhline(1 - published, color='0.5', linestyle='--', label=label)
    axes.set(xlabel='minutes of training', ylabel='share of wrong edges')
    axes.set_title(f'{result["system"]}, {result["n_objects"]} objects, without labels')
    axes.legend()
    files.write_atomically(path, lambda temporary: figure.savefig(temporary, format='png', dpi=120))


def define_flags():
    flags.DEFINE_enum('system', 'springs', sorted(simulate.SYSTEMS), 'What to simulate.')
    flags.DEFINE_integer('n_objects', 5, 'V, number of objects.')
    flags.DEFINE_string('work_path', None, 'Folder for data and model.', required=True)
    flags.DEFINE_boolean('central', False, 'Forces between objects are central: no encoder.')
    flags.DEFINE_string('model_path', None, 'A model that was trained elsewhere: only judged.')
    flags.DEFINE_integer('num_seeds', 1, 'Trainings from as many seeds.', 1)
    flags.DEFINE_string('output_path', 'docs', 'Folder for the JSON file and the picture.')


def main(given) -> None:
    os.makedirs(given.output_path, exist_ok=True)
    command.import_tensorflow(1)  # one core, as the table says
    counts, config = settings_of(given.system, given.n_objects, given.central)
    result, *others = (
        run(given.system, given.n_objects, given.work_path, counts,
            dataclasses.replace(config, seed=seed), given.model_path)
        for seed in range(given.num_seeds)
    )  # fmt: skip
    result['other_seeds'] = [other['test_accuracy'] for other in others]
    name = f'nri_{given.system}{given.n_objects}' + '_central' * given.central
    name += '_gpu' * bool(given.model_path)
    stem = os.path.join(given.output_path, name)
    files.write_json(f'{stem}.json', record.provenance(1) | result)
    draw(result, f'{stem}.png')
    print(f'wrote {stem}.json and .png: {result["test_accuracy"]:.2%} of the edges right')
