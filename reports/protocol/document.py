"""The document of one dataset: models made and rolled out, baselines fitted, all runs judged."""

import glob
import os

import numpy as np
import tqdm

from learning_to_simulate.soil_truth import PARTICLES
from pca_tools import dataset, files, workers
from reports import record
from reports.protocol import curve, rollouts, run_errors
from reports.protocol.truth import TruthReader

SPLITS = ('valid', 'test')
SCHEMA_VERSION = 1


def data_facts(reader: TruthReader, truths: dict) -> dict:
    """What the judged data are."""
    names = ['train', *SPLITS]
    first = truths[SPLITS[0]][0]
    return {
        'path': os.path.relpath(reader.folder, record.ROOT),
        'version': record.data_version(reader.metadata),
        'train_runs': len(dataset.read_split(reader.folder, 'train')),
        'sha256': {
            f'{n}.tfrecord': files.sha256_of_file(dataset.split_path(reader.folder, n))
            for n in names
        },
        'truth': _truth_in_words(first),
        'spacing_mm': 1e3 * first.spacing,
        'modes': reader.metadata['mode_number'],
    }


def _truth_in_words(truth):
    count, frames = len(truth.soil.indices), np.unique(np.diff(truth.soil.frames)).tolist()
    text = f'{count} particles in every {"" if frames == [1] else f"{frames[0]}. "}frame'
    if truth.soil.space != PARTICLES:
        text += ', decoded from the modes; what the modes cut off is added to errors of whole runs'
    return text


def run_facts(truth) -> dict:
    """What tables say of a run."""
    return {
        'record': truth.record,
        'case': truth.case,
        'kind': truth.kind,
        'motion_mm': truth.motion,
        'truncation_mm': truth.truncation,
    }


def clean(errors: dict) -> dict:
    """Errors of a run as JSON: what is not finite is None, and counts as failed."""
    if isinstance(errors, dict):
        return {k: clean(v) for k, v in errors.items()}
    return None if isinstance(errors, float) and not np.isfinite(errors) else errors


def judge(reader: TruthReader, methods: list[dict], progress=iter) -> dict:
    """Runs and errors of all methods.

    Args:
      reader: of the dataset.
      methods: dicts of `name`, `baseline`, `about` and `seeds`: dicts of `seed`, `source` and
        `predictions` (split -> `RunPrediction` per record).
      progress: wraps the list of runs.

    Returns:
      `data`, `runs` (split -> facts of each run) and `methods` with the errors of every run in
      place of the predictions.
    """
    judged = [
        {k: m[k] for k in ('name', 'baseline', 'about')}
        | {
            'seeds': [
                {k: s[k] for k in ('seed', 'source', 'curve') if k in s}
                | {'runs': {n: [] for n in SPLITS}}
                for s in m['seeds']
            ]
        }
        for m in methods
    ]
    runs: dict[str, list] = {split: [] for split in SPLITS}
    first: dict[str, list] = {}
    for split in SPLITS:
        for truth in progress(reader.runs(split)):
            first.setdefault(split, [truth])
            runs[split].append(run_facts(truth))
            for method, out in zip(methods, judged, strict=True):
                for seed, row in zip(method['seeds'], out['seeds'], strict=True):
                    prediction = seed['predictions'][split][truth.record]
                    errors = run_errors.run_errors(prediction, truth)
                    row['runs'][split].append(clean(errors))
    return {'data': data_facts(reader, first), 'runs': runs, 'methods': judged}


def name_of(data_path: str) -> str:
    """What the dataset is called: its folder. Datasets of two versions are of one scene."""
    return os.path.basename(os.path.abspath(data_path))


def _models_of(dataset_name, values):
    """Method -> model folders, from --model or those shipped for the dataset."""
    found: dict[str, list] = {}
    given = values.model
    if not given:
        shipped = sorted(glob.glob(os.path.join(record.ROOT, 'models', dataset_name, '*')))
        given = [f'{os.path.basename(path)}={path}' for path in shipped]
    for item in given:
        name, _, path = item.partition('=')
        if not path:
            raise ValueError(f'--model={item}: NAME=FOLDER was expected')
        found.setdefault(name, []).append(path)
    folder = os.path.join(values.work_path, 'models', dataset_name)
    return found | {
        name: [
            os.path.join(folder, f'{rollouts.name_of_folder(name)}_{seed}')
            for seed in rollouts.seeds_of(name, values.num_seeds)
        ]
        for name in values.train
    }


def _jobs(found, data_path, values, folder):
    """The tasks of `rollouts.make`; only models of --train are trained."""
    jobs = []
    for name, paths in found.items():
        for seed, path in enumerate(map(os.path.abspath, paths)):
            flags_ = None
            if name in values.train:
                flags_ = [*rollouts.flags_of_seed(name, seed), '--num_threads=1']
            jobs.append((os.path.abspath(data_path), path, flags_, SPLITS, folder))
    return jobs


def _make_models(found, data_path, values) -> str:
    """Trains the models of --train and rolls all out, side by side; returns the rollouts' folder.

    Raises:
      ValueError: some failed; the others are made, and the same call goes on.
    """
    folder = os.path.abspath(os.path.join(values.work_path, 'rollouts', name_of(data_path)))
    jobs = _jobs(found, data_path, values, folder)
    failed = []
    with (
        workers.start(values.cluster, values.num_processes) as crew,
        tqdm.tqdm(total=len(jobs), unit='model', desc='training, rolling out', disable=None) as bar,
    ):
        for outcome in crew.run(rollouts.make, jobs):
            if outcome.error is not None:
                failed.append(f'{jobs[outcome.index][1]}: {outcome.error}')
            bar.update()
    if failed:
        raise ValueError(
            f'{len(failed)} of {len(jobs)} models failed, the others are made:\n'
            + '\n'.join(failed)
        )
    return folder


def _model_method(name, paths, data_path, reader, folder):
    """A method of the seeds of one model, which are trained and rolled out."""
    seeds = []
    for path in paths:
        config = files.read_json(os.path.join(path, 'config.json'))
        predictions = {}
        for split in SPLITS:
            rolled = rollouts.roll_out(data_path, path, split, folder)
            count = len(dataset.read_split(data_path, split))
            predictions[split] = rollouts.read(rolled, split, count, reader.metadata)
        shipped = os.path.abspath(path).startswith(record.ROOT + os.sep)
        seeds.append(
            {
                'seed': config.get('config', {}).get('seed'),
                'source': os.path.relpath(path, record.ROOT) if shipped else 'trained for this',
                'curve': curve.of_training(path),
                'predictions': predictions,
            }
        )
    about = {'preset': config.get('config', {}).get('preset')}
    return {'name': name, 'baseline': False, 'about': about, 'seeds': seeds}


def protocol(data_path: str, values) -> dict:
    """The document of one dataset, without what `tables.complete` adds; see `judge`.

    Args:
      data_path: its folder.
      values: flags of the command.
    """
    from reports.protocol import baselines  # loads TensorFlow, and --help does not wait for it

    reader = TruthReader(data_path)
    scene = reader.metadata.get('scene', {}).get('name', name_of(data_path))
    print(f'{data_path}: fitting baselines', flush=True)
    methods = [
        {
            'name': b.name,
            'baseline': True,
            'about': b.about,
            'seeds': [
                {
                    'seed': None,
                    'source': 'fitted for this',
                    'predictions': {n: baselines.predictions(b, reader, n) for n in SPLITS},
                }
            ],
        }
        for b in baselines.fit_all(reader)
    ]
    found = _models_of(name_of(data_path), values)
    folder = _make_models(found, data_path, values)
    for name, paths in found.items():
        methods.append(_model_method(name, paths, data_path, reader, folder))

    def progress(runs):
        return tqdm.tqdm(runs, unit='run', desc='judging', disable=None)

    return {
        'schema_version': SCHEMA_VERSION,
        'scene': scene,
        'record': record.provenance(),
        **judge(reader, methods, progress),
    }
