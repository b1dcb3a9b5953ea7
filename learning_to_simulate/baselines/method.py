"""The open-loop methods on disk: fit, model folder, rollouts; see `registry`.

A model folder holds `config.json` (settings, scene, ranges of training, digests of the data, and
for a formula its parameters) and, of a regression, `path_ridge.npz`.
"""

import dataclasses
import os
import time
from types import SimpleNamespace

import numpy as np
import tqdm

from learning_to_simulate import (
    checkpoints,
    evaluation,
    metrics,
    normalization,
    presets,
    reading_utils,
    rollout_status,
)
from learning_to_simulate.baselines import open_loop, path_ridge
from learning_to_simulate.baselines.earthmoving import EarthmovingForce, soil_parameters
from learning_to_simulate.baselines.settings import OpenLoopConfig
from learning_to_simulate.baselines.wheel_terramechanics import WheelTerramechanics
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.registry import OpenedModel
from learning_to_simulate.rollout import Rollout
from learning_to_simulate.scene import Scene
from learning_to_simulate.tool import bed
from learning_to_simulate.tool.axes import Axes
from pca_tools import dataset, files
from pca_tools.storage import folder_lock

_UNITS = {open_loop.SOIL: 'm of a score', open_loop.FORCE: 'N', open_loop.HEIGHT: 'm'}
_FORMULAS = {'earthmoving': EarthmovingForce, 'bekker_wong_janosi': WheelTerramechanics}


@dataclasses.dataclass
class OpenLoopModel:
    """A fitted method as evaluations take it.

    Attributes:
      simulator: its `config`, `scene` and `statistics` (the ranges that rollouts are judged by).
      method: `PathRidge`, `EarthmovingForce` or `WheelTerramechanics`.
    """

    simulator: SimpleNamespace
    method: object

    def layout(self, n_rigid: int):
        """No graph."""
        n_node = n_rigid + self.simulator.scene.n_modes
        return SimpleNamespace(n_node=n_node, n_edge=0, senders=(), receivers=())

    def edge_counts(self) -> dict[str, int]:
        """None: there is no graph."""
        return {}


class OpenLoopEvaluator:
    """Rollouts of an open-loop method, as `evaluation.Evaluator`.

    Args:
      model: the method.
      metadata: of the dataset; its `cases` hold the soil's parameters.
      split: of the runs that are rolled out.
    """

    def __init__(self, model: OpenLoopModel, metadata: dict, split: str):
        self._model, self._metadata, self._split = model, metadata, split
        self.scene = model.simulator.scene

    def roll_out(self, group) -> Rollout:
        """`Rollout` of one `RunGroup` of the split."""
        simulator = self._model.simulator
        start = time.perf_counter()
        predicted = self._model.method.predict(group, cases_of(group, self._split, self._metadata))  # type: ignore[attr-defined]
        seconds = time.perf_counter() - start
        judgements = rollout_status.judge(
            group, predicted.position, predicted.force, simulator.statistics, simulator.scene
        )
        return Rollout(predicted.position, predicted.force, judgements, seconds, predicted.torque)

    def run(self, groups, split: str, progress=iter):
        """Rolls out every run; arguments and results as of `evaluation.Evaluator.run`."""
        results = evaluation.roll_out_all(self.roll_out, groups, progress)
        return results, evaluation.summarise(results, self._model, self._metadata, split)


def cases_of(group, split: str, metadata: dict) -> list:
    """Per run of a group, its entry in the metadata's `cases`; {} where there is none."""
    cases = metadata.get('cases', {}).get(split, [])
    return [cases[i] if i < len(cases) else {} for i in group.record]


def fit(config: OpenLoopConfig, data_path: str, metadata: dict, train_groups, valid_groups, scene):
    """The method of a config, fitted to the runs of a dataset.

    Args:
      config: which one.
      data_path: dataset folder; its subspace holds the resting bed.
      metadata: of the dataset.
      train_groups, valid_groups: lists of `RunGroup`; valid chooses what a ridge is like.
      scene: of the dataset.

    Raises:
      ValueError: a scene that the method does not fit.
    """
    scene.check_one_body(f'the method {config.model}')
    bodies = train_groups[0].position[:, :, : train_groups[0].n_rigid]
    if not bodies.shape[2]:
        raise ValueError(f'{config.model} needs a rigid body; {data_path} has none')
    axes = Axes.of_bodies([bodies], scene.up_axis)
    surface = bed.height_of_dataset(data_path, metadata, axes)
    if config.model == 'path_ridge':

        def progress(choices):
            return tqdm.tqdm(choices, unit='choice', desc='path ridge', disable=None)

        few_runs = {'leave_one_out': True, 'kernels': tuple(path_ridge.KERNELS), 'n_best': 10}
        return path_ridge.PathRidge.fit(
            train_groups, valid_groups, scene, surface, config.max_samples, progress=progress,
            **(few_runs if config.leave_one_out else {}),
        )  # fmt: skip
    if not scene.has_force:
        raise ValueError(f'{config.model} is a formula of the force, which {data_path} lacks')
    cases = [cases_of(group, 'train', metadata) for group in train_groups]
    if config.model == 'earthmoving':
        for case in (case for of_group in cases for case in of_group):
            soil_parameters(case)
        if surface is None:
            raise ValueError(
                f'{data_path}: has no subspace.npz, so the height of the bed is not known, which '
                f'earthmoving needs'
            )
        method = EarthmovingForce(scene, axes, surface)
    else:
        method = WheelTerramechanics(scene, axes)
    return method.fitted(train_groups, cases) if config.fitted else method


def train(data_path, model_path, config, options) -> dict:
    """Fits a method and leaves its model folder, or finds it done; see `registry.train`."""
    metadata = dataset.read_metadata(data_path)
    groups = reading_utils.read_groups(data_path, 'train', metadata)
    valid = reading_utils.read_groups(data_path, 'valid', metadata)
    scene = reading_utils.read_scene(data_path, metadata, groups, options.rigid_motion)
    data = checkpoints.data_record(data_path, metadata)
    parts = {'config': dataclasses.asdict(config), 'data': data}
    with folder_lock.locked(model_path, options.take_over_lock):
        if not checkpoints.holds_model(model_path, parts, [path_ridge.FILE_NAME]):
            method = fit(config, data_path, metadata, groups, valid, scene)
            _save(model_path, config, scene, method, groups, metadata, data)
        model = load(model_path)
    _, summary = OpenLoopEvaluator(model, metadata, 'valid').run(valid, 'valid')
    print(evaluation.table(summary))
    if config.leave_one_out:
        off = model.method.least_errors()  # type: ignore[attr-defined]
        print(
            'valid was trained on, so the table says how well it is fitted; the best choice, each '
            'run left out, is off by (RMS per value): '
            + ', '.join(f'{name} {error:.3g} {_UNITS[name]}' for name, error in off.items())
        )
    print(f'fitted {config.preset}: {model_path}')
    return summary


def _save(path, config, scene, method, groups, metadata, data):
    """Writes the model folder, config.json last: it says that the rest is there."""
    statistics = normalization.compute_statistics(
        [g.position for g in groups],
        [g.force for g in groups],
        reading_utils.contexts_by_frame(groups),
        metadata,
        scene,
        presets.PRESETS['pcg'],
    )
    formula = None
    if isinstance(method, path_ridge.PathRidge):
        method.save(os.path.join(path, path_ridge.FILE_NAME))
    else:
        formula = {'frame': dataclasses.asdict(method.axes), **method.parameters_to_json()}
    files.write_json(
        os.path.join(path, checkpoints.CONFIG_FILE),
        {
            'schema_version': checkpoints.SCHEMA_VERSION,
            'config': dataclasses.asdict(config),
            'scene': scene.to_json(),
            'statistics': statistics.to_json(),
            'formula': formula,
            'n_rigid': groups[0].n_rigid,
            'data': data,
        },
    )


def load(model_path: str) -> OpenLoopModel:
    """A fitted method.

    Raises:
      FileNotFoundError, ValueError: no model there, or a damaged one.
    """
    stored = checkpoints.read_config(model_path)
    try:
        config = OpenLoopConfig(**stored['config'])
        scene = Scene.from_json(stored['scene'])
        statistics = normalization.Statistics.from_json(stored['statistics'])
        if config.model == 'path_ridge':
            path = os.path.join(model_path, path_ridge.FILE_NAME)
            method = path_ridge.PathRidge.load(path)
        else:
            values = dict(stored['formula'])
            axes = Axes(**values.pop('frame'))
            method = _FORMULAS[config.model].from_json(values, scene, axes)  # type: ignore[attr-defined]
    except FileNotFoundError:
        raise
    except checkpoints.WRONG_FIELD as error:
        raise ValueError(
            f'{model_path}/{checkpoints.CONFIG_FILE}: a field is missing, unknown or wrong '
            f'({error!r})'
        ) from error
    return OpenLoopModel(SimpleNamespace(config=config, scene=scene, statistics=statistics), method)


def open_model(model_path, data_path, split, overrides=None, raw_path=None) -> OpenedModel:
    """A fitted method with the runs of a split; see `registry`."""
    model = load(model_path)
    config = model.simulator.config
    checkpoints.refuse_contradictions(model_path, config, overrides or {})
    metadata = dataset.read_metadata(data_path)
    whole = SimpleNamespace(config=SimpleNamespace(modes=0), scene=model.simulator.scene)
    checkpoints.check_dataset(model_path, SimpleNamespace(simulator=whole), data_path, metadata)
    groups = reading_utils.read_groups(data_path, split, metadata)
    evaluator = OpenLoopEvaluator(model, metadata, split)
    return OpenedModel(
        model, groups, metadata, evaluator, lambda: _one_step_errors(evaluator, groups)
    )


def _one_step_errors(evaluator, groups):
    """Mean squared errors of the first predicted frame: each frame is a prediction of its own."""
    rows = []
    for group in groups:
        rollout, first = evaluator.roll_out(group), slice(H, H + 1)
        n_soil = evaluator.scene.n_soil
        soil = metrics.soil_mse(
            rollout.position[:, :1], group.position[:, first], group.n_rigid, n_soil
        )
        rows.append({'one_step_position_mse': soil})
        if rollout.force is not None:
            square = (rollout.force[:, :1] - group.force[:, first]) ** 2
            rows[-1]['one_step_force_mse'] = square.mean(axis=(1, 2))
    return {key: float(np.concatenate([row[key] for row in rows]).mean()) for key in rows[0]}
