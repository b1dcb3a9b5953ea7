"""The baselines of the protocol, fitted to a dataset: what they are and what they predict."""

import dataclasses
from collections.abc import Callable

import numpy as np
import tqdm

from learning_to_simulate import reading_utils
from learning_to_simulate.methods import open_loop, resting_bed, tool_motion
from learning_to_simulate.methods.earthmoving import EarthmovingForce
from learning_to_simulate.methods.path_ridge import PathRidge
from learning_to_simulate.methods.wheel_terramechanics import CONTEXT, WheelTerramechanics
from learning_to_simulate.scene import RigidMotion
from reports.protocol import rollouts
from reports.protocol.run_errors import RunPrediction
from reports.protocol.truth import TruthReader


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


def fit_all(reader: TruthReader, quiet: bool = False) -> list[Baseline]:
    """All baselines that the scene of a dataset has.

    Args:
      reader: of the dataset; train fits, valid chooses, test is not opened.
      quiet: whether there is no progress bar.

    Raises:
      ValueError: a scene without a known body; every baseline but persistence needs one.
    """
    folder, metadata = reader.folder, reader.metadata
    train = reading_utils.read_groups(folder, 'train', metadata)
    valid = reading_utils.read_groups(folder, 'valid', metadata)
    scene = reading_utils.read_scene(folder, metadata, train, None)
    bodies = train[0].position[:, :, : train[0].n_rigid]
    frame = tool_motion.TravelFrame.of(bodies, scene.up_axis)
    surface = resting_bed.flat_surface(
        reader.subspace.initial, frame, reader.kept_spacing, reader.spacing('train', 0)
    )
    found = [
        Baseline('persistence', {}, lambda group, _: open_loop.persistence(group, scene)),
        Baseline(
            'constant velocity', {}, lambda group, _: open_loop.constant_velocity(group, scene)
        ),
    ]
    if scene.has_force:
        mean = np.concatenate([g.force.reshape(-1, g.force.shape[-1]) for g in train]).mean(axis=0)
        found.append(
            Baseline(
                'mean force',
                {'mean_N': mean.tolist()},
                lambda group, _: open_loop.mean_force(group, scene, mean),
            )
        )

    def progress(choices):
        return tqdm.tqdm(choices, unit='choice', desc='path ridge', disable=quiet or None)

    ridge = PathRidge.fit(train, valid, scene, surface, progress=progress)
    about = {
        name: {'inputs': r.inputs, 'gamma': r.gamma, 'alpha': r.alpha, 'samples': len(r.samples)}
        for name, r in ridge.regressions.items()
    }
    found.append(Baseline('path ridge', about, lambda group, _: ridge.predict(group)))
    if scene.has_force:
        found += _mechanics(scene, frame, surface, train, metadata)
    return found


def _mechanics(scene, frame, surface, train, metadata):
    """The published formulas of the tool's force, with the soil's parameters and fitted."""
    cases = [cases_of(g, 'train', metadata) for g in train]
    described = all(c and 'soil' in c for of_group in cases for c in of_group)
    if scene.rigid_motion == RigidMotion.PRESCRIBED and described:
        own = EarthmovingForce(scene, frame, surface)
        fitted = own.fitted(train, cases)
        about = {'gains_wedge_heap_by_backward_up': fitted.gains.tolist()}
        name = 'earthmoving'
    elif scene.rigid_motion == RigidMotion.DRIVEN and set(CONTEXT) <= set(scene.context_names):
        own = WheelTerramechanics(scene, frame)
        fitted = own.fitted(train, cases)
        about = dataclasses.asdict(fitted.parameters)
        name = 'Bekker-Wong-Janosi'
    else:
        return []
    return [
        Baseline(name, {'surface_m': surface}, own.predict),
        Baseline(f'{name}, fitted', about, fitted.predict),
    ]


def cases_of(group, split: str, metadata: dict) -> list:
    """Per run of a group, its entry in the metadata's `cases`; None where there is none."""
    cases = metadata.get('cases', {}).get(split, [])
    return [cases[i] if i < len(cases) else None for i in group.record]


def predictions(baseline: Baseline, reader: TruthReader, split: str) -> list[RunPrediction]:
    """What a baseline says of each run of a split, in the order of the records."""
    metadata = reader.metadata
    groups = reading_utils.read_groups(reader.folder, split, metadata)
    scene = reading_utils.read_scene(reader.folder, metadata, groups, None)
    found = {}
    for group in groups:
        prediction = baseline.predict(group, cases_of(group, split, metadata))
        for run, record in enumerate(group.record):
            found[int(record)] = rollouts.from_open_loop(prediction, group, run, scene)
    return [found[record] for record in sorted(found)]
