"""The baselines of the protocol, fitted to a dataset: what they are and what they predict."""

import dataclasses
from collections.abc import Callable

import numpy as np

from learning_to_simulate import presets, reading_utils
from learning_to_simulate.baselines import method as method_lib
from learning_to_simulate.baselines import open_loop
from reports.protocol import rollouts
from reports.protocol.run_errors import RunPrediction
from reports.protocol.truth import TruthReader

# What tables call the presets.
_NAMES = {
    'path_ridge': 'path ridge',
    'earthmoving': 'earthmoving',
    'earthmoving_fitted': 'earthmoving, fitted',
    'bekker_wong_janosi': 'Bekker-Wong-Janosi',
    'bekker_wong_janosi_fitted': 'Bekker-Wong-Janosi, fitted',
}


@dataclasses.dataclass(frozen=True)
class Baseline:
    """A baseline that is ready to predict.

    Attributes:
      name: in tables.
      about: what was fitted or chosen, for the record.
      predict: of a `RunGroup` and, per run, its case -> `open_loop.Prediction`.
    """

    name: str
    about: dict
    predict: Callable


def trivial(reader: TruthReader) -> list[Baseline]:
    """What needs no fit: persistence, constant velocity, and the mean force of train.

    Raises:
      ValueError: no train runs.
    """
    train = reading_utils.read_groups(reader.folder, 'train', reader.metadata)
    scene = reading_utils.read_scene(reader.folder, reader.metadata, train, None)
    found = [
        Baseline('persistence', {}, lambda group, _: open_loop.persistence(group, scene)),
        Baseline(
            'constant velocity', {}, lambda group, _: open_loop.constant_velocity(group, scene)
        ),
    ]
    if scene.has_force:
        mean, torque = (_mean([getattr(g, name) for g in train]) for name in ('force', 'torque'))
        found.append(
            Baseline(
                'mean force',
                {'mean_N': mean.tolist()}
                | ({} if torque is None else {'mean_Nm': torque.tolist()}),
                lambda group, _: open_loop.mean_force(group, scene, mean, torque),
            )
        )
    return found


def fit_all(reader: TruthReader) -> list[Baseline]:
    """All baselines that the scene of a dataset has: train fits, valid chooses, test is not opened.

    Raises:
      ValueError: no train or valid runs.
    """
    folder, metadata = reader.folder, reader.metadata
    train, valid = (reading_utils.read_groups(folder, n, metadata) for n in ('train', 'valid'))
    scene = reading_utils.read_scene(folder, metadata, train, None)
    found = trivial(reader)
    for preset, config in presets.OPEN_LOOP.items():
        if config.leave_one_out:  # trains on valid, which chooses here
            continue
        try:
            method = method_lib.fit(config, folder, metadata, train, valid, scene)
        except ValueError as error:  # a blade's formula has no wheel, and so on
            print(f'  no {preset}: {error}', flush=True)
            continue
        about = (
            {n: {'inputs': r.inputs, 'gamma': r.gamma, 'alpha': r.alpha, 'samples': len(r.samples)}
             for n, (r,) in method.regressions.items()}
            if preset == 'path_ridge'
            else method.parts()[0]
        )  # fmt: skip
        found.append(Baseline(_NAMES[preset], about, method.predict))
    return found


def _mean(arrays):
    """Mean [D] over runs and frames of arrays [S, T, D]; None where there are none."""
    rows = [a.reshape(-1, a.shape[-1]) for a in arrays if a is not None]
    return np.concatenate(rows).mean(axis=0) if rows else None


def predictions(baseline: Baseline, reader: TruthReader, split: str) -> list[RunPrediction]:
    """What a baseline says of each run of a split, in the order of the records."""
    metadata = reader.metadata
    groups = reading_utils.read_groups(reader.folder, split, metadata)
    scene = reading_utils.read_scene(reader.folder, metadata, groups, None)
    found = {}
    for group in groups:
        cases = method_lib.cases_of(group, split, metadata)
        prediction = baseline.predict(group, cases)
        for run, record in enumerate(group.record):
            found[int(record)] = rollouts.from_open_loop(prediction, group, run, scene)
    return [found[record] for record in sorted(found)]
