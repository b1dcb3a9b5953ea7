"""The document of one dataset: models and baselines made, rolled out and judged, run by run."""

import dataclasses
import glob
import os

import numpy as np
import tqdm

from learning_to_simulate import soil_truth
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from pca_tools import dataset, files, workers
from reports import record
from reports.protocol import rollouts
from reports.protocol.over_runs import GRID

SPLITS = ('valid', 'test')
SCHEMA_VERSION = 1
_FORCE = ('force', 'drawbar', 'vertical')
# Baselines that are fitted: preset -> its name in tables, and what it says anything of.
BASELINES = {
    'path_ridge': ('path ridge', ('soil', 'height', *_FORCE)),
    'earthmoving': ('earthmoving', _FORCE),
    'earthmoving_fitted': ('earthmoving, fitted', _FORCE),
    'bekker_wong_janosi': ('Bekker-Wong-Janosi', ('height', *rollouts.LOADS)),
    'bekker_wong_janosi_fitted': ('Bekker-Wong-Janosi, fitted', ('height', *rollouts.LOADS)),
}
# Those that need no fit stand beside every model: key of its metrics, and what is said.
TRIVIAL = {
    'persistence': ('stay_still', ('soil', 'height', *rollouts.LOADS)),
    'constant velocity': ('constant_velocity', ('soil', 'height')),
    'mean force': ('constant_velocity', rollouts.LOADS),
}


@dataclasses.dataclass(frozen=True)
class Method:
    """What is judged.

    Attributes:
      name: in tables.
      models: (model folder, flags of its training or None where it is trained) of each seed.
      said: of `rollouts.read`.
      baseline: whether others are compared with it.
    """

    name: str
    models: list[tuple]
    said: tuple[str, ...] | None = None
    baseline: bool = False


def name_of(data_path: str) -> str:
    """What the dataset is called: its folder. Datasets of two versions are of one scene."""
    return os.path.basename(os.path.abspath(data_path))


def data_version(metadata: dict) -> int:
    """Of a dataset: that of the first case that states one; 1 of those made before it was."""
    cases = (case for split in metadata.get('cases', {}).values() for case in split)
    return int(next((case['data_version'] for case in cases if 'data_version' in case), 1))


def facts(data_path: str) -> tuple[dict, dict]:
    """What the judged data are, and split -> what tables say of each run.

    Raises:
      FileNotFoundError: no dataset, or one without `subspace.npz` (nothing can be judged in full
        space without it).
    """
    reader = soil_truth.TruthReader(data_path)
    if reader.subspace is None:
        path = os.path.join(data_path, 'subspace.npz')
        raise FileNotFoundError(
            f'{path}: no such file; errors in full space need the subspace of the records'
        )
    runs: dict[str, list] = {split: [] for split in SPLITS}
    for split in SPLITS:
        for number, run in enumerate(dataset.read_split(data_path, split)):
            scores = run.position[:, run.n_rigid :].astype(np.float64)
            soil = reader.read(split, number, scores, None)
            runs[split].append(_run_facts(reader.metadata, split, number, soil, scores))
    names = ['train', *SPLITS]
    return {
        'path': os.path.relpath(data_path, record.ROOT),
        'version': data_version(reader.metadata),
        'train_runs': len(dataset.read_split(data_path, 'train')),
        'sha256': {
            f'{n}.tfrecord': files.sha256_of_file(dataset.split_path(data_path, n)) for n in names
        },
        'truth': _truth_in_words(soil),
        'modes': reader.metadata['mode_number'],
    }, runs


def _run_facts(metadata, split, number, soil, scores):
    """Of one run: its case, how far its soil moves, and what the modes cut off (root mean squares
    over particles, axes and frames after the given ones)."""
    cut, motion, case = (
        soil_truth.of_run(metadata.get(key), split, number)
        for key in ('projection_mse', 'motion_mse', 'cases')
    )
    if soil.space == soil_truth.PARTICLES:
        cut, motion = soil.mean_square(soil.of_modes(scores[H:])).mean(), None
    if motion is None:
        motion = ((soil.particles - soil.start) ** 2).mean()
    case = case or {}
    return {
        'record': number,
        'case': case.get('case', number),
        'kind': case.get('kind') or GRID,
        'motion_mm': float(1e3 * np.sqrt(motion)),
        'truncation_mm': None if cut is None else float(1e3 * np.sqrt(cut)),
    }


def _truth_in_words(soil):
    stride = int(np.diff(soil.frames)[0])
    every = 'every frame' if stride == 1 else f'every {stride}. frame'
    text = f'{len(soil.indices)} particles in {every}'
    if soil.space != soil_truth.PARTICLES:
        text += ', decoded from the modes; what the modes cut off is added to errors of whole runs'
    return text


def methods_of(dataset_name: str, values) -> list[Method]:
    """The fitted baselines, the models of --model or those shipped for the dataset, and those of
    --train.

    Raises:
      ValueError: no NAME=FOLDER, or a method of --train that cannot be.
    """
    folder = os.path.join(values.work_path, 'models', dataset_name)
    found = []
    for preset, (name, said) in BASELINES.items():
        ((path, flags),) = rollouts.trainings(preset, 1, os.path.join(folder, 'baselines'))
        found.append(Method(name, [(path, flags)], said, baseline=True))
    shipped = sorted(glob.glob(os.path.join(record.ROOT, 'models', dataset_name, '*')))
    given: dict[str, list] = {}
    for item in values.model or [f'{os.path.basename(path)}={path}' for path in shipped]:
        name, _, path = item.partition('=')
        if not path:
            raise ValueError(f'--model={item}: NAME=FOLDER was expected')
        given.setdefault(name, []).append((path, None))
    for name in values.train:
        given[name] = rollouts.trainings(name, values.num_seeds, folder)
    return found + [Method(name, models) for name, models in given.items()]


def _make(methods, data_path, values, folder) -> list[Method]:
    """Trains and rolls out all models, side by side; returns the methods without the baselines that
    do not fit the scene.

    Raises:
      ValueError: other models failed; the rest is made, and the same call goes on.
    """
    jobs = [
        (os.path.abspath(data_path), os.path.abspath(path), flags, SPLITS, folder)
        for method in methods
        for path, flags in method.models
    ]
    of_job = [method for method in methods for _ in method.models]
    failed = {}
    with (
        workers.start(values.cluster, values.num_processes) as crew,
        tqdm.tqdm(total=len(jobs), unit='model', desc='training, rolling out', disable=None) as bar,
    ):
        for outcome in crew.run(rollouts.make, jobs):
            if outcome.error is not None:
                failed[outcome.index] = f'{jobs[outcome.index][1]}: {outcome.error}'
            bar.update()
    absent = [of_job[i] for i in failed if of_job[i].baseline]  # a blade's formula has no wheel
    for method in absent:
        print(f'  no {method.name}: {failed[of_job.index(method)].splitlines()[-1]}', flush=True)
    if bad := [text for i, text in failed.items() if not of_job[i].baseline]:
        raise ValueError(
            f'{len(bad)} of {len(jobs)} models failed, the others are made:\n' + '\n'.join(bad)
        )
    return [method for method in methods if method not in absent]


def judged(method: Method, data_path: str, folder: str) -> dict:
    """A method whose models are rolled out, as the document holds it."""
    seeds = []
    for path, _ in method.models:
        config = files.read_json(os.path.join(path, 'config.json'))
        shipped = os.path.abspath(path).startswith(record.ROOT + os.sep)
        rolled = {split: rollouts.roll_out(data_path, path, split, folder) for split in SPLITS}
        seeds.append(
            {
                'seed': config.get('config', {}).get('seed'),
                'source': os.path.relpath(path, record.ROOT) if shipped else 'trained for this',
                'curve': rollouts.curve(path),
                'runs': {split: rollouts.read(rolled[split], said=method.said) for split in SPLITS},
            }
        )
    about = {'preset': config.get('config', {}).get('preset')}
    # What a ridge chose from is thousands of lines.
    about |= {k: v for k, v in config.get('method', {}).items() if k != 'choices'}
    return {'name': method.name, 'baseline': method.baseline, 'about': about, 'seeds': seeds}


def trivial(folders: list[str]) -> list[dict]:
    """The predictors that need no fit, from the rollouts of any models of a dataset.

    Args:
      folders: of `rollouts.roll_out`, above the splits. Errors of a torque stand beside models that
        predict one only, so all are read; what two of them hold is the same.
    """
    found = []
    for name, (key, said) in TRIVIAL.items():
        runs: dict[str, list] = {}
        for split in SPLITS:
            of_models = [rollouts.read(os.path.join(f, split), key, said) for f in folders]
            runs[split] = [
                {k: v for row in reversed(rows) for k, v in row.items()} for rows in zip(*of_models)
            ]
        if any(runs['test']):
            seed = {'seed': None, 'source': 'fitted for this', 'runs': runs}
            found.append({'name': name, 'baseline': True, 'about': {}, 'seeds': [seed]})
    return found


def protocol(data_path: str, values) -> dict:
    """The document of one dataset, without what `tables.complete` adds.

    Args:
      data_path: its folder.
      values: flags of the command.

    Raises:
      ValueError: models failed; see `methods_of`.
    """
    data, runs = facts(data_path)
    name = name_of(data_path)
    folder = os.path.abspath(os.path.join(values.work_path, 'rollouts', name))
    print(f'{data_path}: training and rolling out', flush=True)
    methods = _make(methods_of(name, values), data_path, values, folder)
    folders = [
        os.path.dirname(rollouts.roll_out(data_path, path, SPLITS[0], folder))
        for method in methods
        for path, _ in method.models
    ]
    found = [judged(method, data_path, folder) for method in methods]
    return {
        'schema_version': SCHEMA_VERSION,
        'scene': dataset.read_metadata(data_path).get('scene', {}).get('name', name),
        'record': record.provenance(),
        'data': data,
        'runs': runs,
        'methods': trivial(folders) + found,
    }
