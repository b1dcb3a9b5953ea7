"""The regression on the path on disk: fit, model folder, rollouts; see `registry`.

A model folder holds `config.json` (settings, scene, ranges of training, digests of the data, and
the parameters of the regression) and its arrays.
"""

import dataclasses
import os
import time
from types import SimpleNamespace

import numpy as np

from learning_to_simulate import (
    bed,
    checkpoints,
    evaluation,
    metrics,
    normalization,
    presets,
    reading_utils,
    rollout_status,
)
from learning_to_simulate.axes import Axes
from learning_to_simulate.baselines import path_ridge
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.config import PathRidgeConfig
from learning_to_simulate.registry import OpenedModel
from learning_to_simulate.rollout import Rollout
from learning_to_simulate.scene import Scene
from pca_tools import dataset, files
from pca_tools.storage import folder_lock

ARRAYS_FILE = 'path_ridge.npz'


@dataclasses.dataclass
class RidgeModel:
    """A fitted regression as evaluations take it; its `simulator` has `config`, `scene` and
    `statistics` (the ranges that rollouts are judged by)."""

    simulator: SimpleNamespace
    method: path_ridge.PathRidge


class RidgeEvaluator(evaluation.Evaluator):
    """Rollouts of a `RidgeModel`."""

    def roll_out(self, group) -> Rollout:
        simulator, start = self._model.simulator, time.perf_counter()
        position, force = self._model.method.predict(group)  # type: ignore[attr-defined]
        seconds = time.perf_counter() - start
        judgements = rollout_status.judge(
            group, position, force, simulator.statistics, simulator.scene
        )
        return Rollout(position, force, judgements, seconds)

    def one_step_errors(self, groups) -> dict[str, float]:
        """Mean squared errors of the first predicted frame: each frame is a prediction of its
        own."""
        found: dict = {}
        n_soil, first = self._model.simulator.scene.n_soil, slice(H, H + 1)
        for group in groups:
            rollout, truth = self.roll_out(group), group.position[:, first]
            soil = metrics.soil_mse(rollout.position[:, :1], truth, group.n_rigid, n_soil)
            found.setdefault('one_step_position_mse', []).extend(soil)
            if rollout.force is not None:
                square = (rollout.force[:, :1] - group.force[:, first]) ** 2
                found.setdefault('one_step_force_mse', []).extend(square.mean(axis=(1, 2)))
        return {key: float(np.mean(values)) for key, values in found.items()}


def train(data_path, model_path, config, options) -> dict:
    """Fits the regression and leaves its model folder, or finds it done; see `registry.train`."""
    metadata = dataset.read_metadata(data_path)
    groups = reading_utils.read_groups(data_path, 'train', metadata)
    valid = reading_utils.read_groups(data_path, 'valid', metadata)
    scene = reading_utils.read_scene(data_path, metadata, groups, options.rigid_motion)
    data = checkpoints.data_record(data_path, metadata)
    parts = {'config': dataclasses.asdict(config), 'scene': scene.to_json(), 'data': data}
    with folder_lock.locked(model_path):
        if not checkpoints.holds_model(model_path, parts, [ARRAYS_FILE]):
            _fit(model_path, config, data_path, metadata, groups, valid, scene, data)
        model = load(model_path)
    _, summary = RidgeEvaluator(model, metadata).run(valid, 'valid')
    print(evaluation.table(summary))
    if config.leave_one_out:
        off = ', '.join(f'{k} {v:.3g} {path_ridge.UNITS[k]}' for k, v in
                        model.method.least_errors().items())  # fmt: skip
        print(
            f'valid was trained on, so the table says how well it is fitted; the best choice, each '
            f'run left out, is off by (RMS per value): {off}'
        )
    print(f'fitted {config.preset}: {model_path}')
    return summary


def _fit(path, config, data_path, metadata, groups, valid, scene, data):
    """Fits the regression to the runs of a dataset folder, whose subspace holds the resting bed,
    and writes its folder. ValueError for a scene that the method does not fit."""
    scene.check_one_body(f'the method {config.model}')
    bodies = groups[0].position[:, :, : groups[0].n_rigid]
    if not bodies.shape[2]:
        raise ValueError(f'{config.model} needs a rigid body; {data_path} has none')
    surface = bed.height_of_dataset(data_path, metadata, Axes.of_bodies([bodies], scene.up_axis))
    method = path_ridge.PathRidge.fit(
        groups, valid, scene, surface, config.max_samples, config.leave_one_out
    )
    usual = presets.PRESETS['pcg']
    statistics = normalization.compute_statistics(groups, metadata, scene, usual)
    values, arrays = method.parts()
    files.write_npz(os.path.join(path, ARRAYS_FILE), **arrays)
    files.write_json(
        os.path.join(path, checkpoints.CONFIG_FILE),
        {
            'schema_version': checkpoints.SCHEMA_VERSION,
            'config': dataclasses.asdict(config),
            'scene': scene.to_json(),
            'statistics': statistics.to_json(),
            'method': values,
            'n_rigid': groups[0].n_rigid,
            'data': data,
        },
    )


def load(model_path: str) -> RidgeModel:
    """A fitted regression; FileNotFoundError, ValueError: no model there, or a damaged one."""
    stored = checkpoints.read_config(model_path)
    path = os.path.join(model_path, ARRAYS_FILE)
    with checkpoints.refusing_wrong_fields(model_path):
        config = PathRidgeConfig(**stored['config'])
        scene = Scene.from_json(stored['scene'])
        statistics = normalization.Statistics.from_json(stored['statistics'])
        arrays = files.read_npz(path)
        method = path_ridge.PathRidge.of_parts(stored['method'], arrays, scene)
    return RidgeModel(SimpleNamespace(config=config, scene=scene, statistics=statistics), method)


def open_model(model_path, data_path, split, raw_path=None) -> OpenedModel:
    """A fitted regression with the runs of a split; see `registry`."""
    model = load(model_path)
    metadata = dataset.read_metadata(data_path)
    checkpoints.check_dataset(model_path, model, data_path, metadata)
    groups = reading_utils.read_groups(data_path, split, metadata)
    evaluator = RidgeEvaluator(model, metadata)
    return OpenedModel(
        model, groups, metadata, evaluator, lambda: evaluator.one_step_errors(groups)
    )
