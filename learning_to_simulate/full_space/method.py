"""Training, rollouts and evaluation of the full-space baseline on disk; see the package."""

import dataclasses
import os
import resource
import time
from types import SimpleNamespace

import numpy as np
import tensorflow as tf

from learning_to_simulate import checkpoints, evaluation, reading_utils
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.config import FullSpaceConfig
from learning_to_simulate.full_space import data_parallel, runs
from learning_to_simulate.full_space.simulator import (
    ParticleSimulator,
    ParticleStatistics,
    compute_statistics,
    history_of,
    typical_radius,
)
from learning_to_simulate.full_space.training import ParticleTrainer
from learning_to_simulate.registry import OpenedModel
from learning_to_simulate.rollout import Rollout
from learning_to_simulate.rollout_status import Judgement, RolloutStatus
from learning_to_simulate.training import loop
from pca_tools import dataset, files


@dataclasses.dataclass
class ParticleModel:
    """A `ParticleSimulator` as model folders and the training loop take it: its edges come and go,
    so it has none to store."""

    simulator: ParticleSimulator
    mode_mask: None = None
    loaded_mask: None = None
    edge_source: None = None

    def layout(self, n_rigid: int):
        return SimpleNamespace(n_edge=0)

    def edge_counts(self) -> dict[str, int]:
        return {}


def make_model(data_path, metadata, group, config, rigid_motion=None) -> ParticleModel:
    """A fresh model for the training runs `group`; ValueError for a scene that it cannot
    simulate."""
    scene = reading_utils.read_scene(data_path, metadata, [group], rigid_motion)
    scene.check_one_body('the method full_space')
    n_particle = group.position.shape[2] - group.n_rigid
    scene = dataclasses.replace(
        scene,
        n_modes=n_particle,
        n_soil=n_particle,
        rigid_edges=(),
        connectivity_radius=typical_radius(group.position[0, 0, group.n_rigid :]),
    )
    types = group.particle_type
    rate_scaled = config.rate_scaled and scene.rigid_motion.is_known
    statistics = compute_statistics(group, scene, rate_scaled)
    simulator = ParticleSimulator(scene, config, statistics, (int(types[0]), int(types[-1])))
    tf.random.set_seed(config.seed)
    simulator.create_variables()
    return ParticleModel(simulator)


def train(data_path, model_path, config, options) -> dict:
    """Trains to the end, or resumes; see `registry.train`."""
    raw_path, share = options.raw_path, data_parallel.Share()
    metadata = dataset.read_metadata(data_path)
    read = [
        runs.read_runs(data_path, raw_path, split, metadata, config.soil_particles)
        for split in ('train', 'valid')
        if os.path.exists(dataset.split_path(data_path, split))
    ]
    model = make_model(data_path, metadata, read[0], config, options.rigid_motion)
    source, scene = runs.RAW if raw_path else runs.DECODED, model.simulator.scene
    weights = sum(int(np.prod(v.shape)) for v in model.simulator.trainable_variables)
    training = loop.Training(
        model=model,
        trainer=ParticleTrainer(model, read[0], share if share.count > 1 else None),
        evaluator=ParticleEvaluator(model, {} if raw_path else metadata),
        valid=read[1:],
        n_rigid=read[0].n_rigid,
        data={
            'path': data_path,
            'source': source,
            'sha256': {'metadata.json': files.sha256_of_file(f'{data_path}/metadata.json')},
        },
        title=f'{config.preset} on {data_path} ({source}): {len(read[0].position)} runs, '
        f'{read[0].n_rigid} rigid and {scene.n_soil} soil particles, radius '
        f'{scene.connectivity_radius:.4g} m, {weights} weights',
    )
    training.agree_on = share.refuse_other_step
    return loop.run(training, share.folder(model_path), options)


def load(path: str) -> ParticleModel:
    """A model for evaluation; FileNotFoundError, ValueError: no full-space model there, or weights
    of another."""
    values = checkpoints.read_config(path)
    with checkpoints.refusing_wrong_fields(path):
        config, scene, types = checkpoints.settings_and_scene(values, FullSpaceConfig)
        statistics = ParticleStatistics.from_json(values['statistics'])
        statistics.check(scene)

    def make():
        simulator = ParticleSimulator(scene, config, statistics, types)
        simulator.create_variables()
        return ParticleModel(simulator)

    return checkpoints.filled(path, make)


def open_model(model_path, data_path, split, overrides=None, raw_path=None) -> OpenedModel:
    """A trained model with the runs of a split; see `registry`. ValueError for particles of another
    source or number, too."""
    model = load(model_path)
    scene, config = model.simulator.scene, model.simulator.config
    checkpoints.refuse_contradictions(model_path, config, overrides or {})
    source = checkpoints.read_config(model_path)['data']['source']
    if source != (runs.RAW if raw_path else runs.DECODED):
        raise ValueError(
            f'{model_path} was trained on particles of {source}: '
            + ('give --raw_path' if source == runs.RAW else 'leave --raw_path out')
        )
    metadata = dataset.read_metadata(data_path)
    group = runs.read_runs(data_path, raw_path, split, metadata, config.soil_particles)
    if group.position.shape[2] - group.n_rigid != scene.n_modes:
        raise ValueError(
            f'{data_path} has {group.position.shape[2] - group.n_rigid} thinned soil particles, '
            f'the model in {model_path} was trained on {scene.n_modes}'
        )
    for part, has in (('force', scene.has_force), ('context', bool(scene.context_names))):
        if (getattr(group, part) is not None) != has:
            raise ValueError(
                f'{data_path} {"lacks" if has else "has"} a {part}, unlike the data of {model_path}'
            )
    metadata = {} if raw_path else metadata
    return OpenedModel(
        model,
        [group],
        metadata,
        ParticleEvaluator(model, metadata),
        lambda: ParticleTrainer(model, group).one_step_errors(),
    )


class ParticleEvaluator(evaluation.Evaluator):
    """As its base; the rows of the model also hold the mean number of edges, and the peak memory of
    the process so far (`peak_memory_mb`). The metadata are {} for particles of raw runs, of which
    nothing is cut off."""

    def __init__(self, model: ParticleModel, metadata: dict):
        super().__init__(model, metadata)
        self._edges: dict[int, float] = {}

    def roll_out(self, group) -> Rollout:
        """Rolls out the one run of a group from its first H frames; stops where it blows up."""
        simulator, n, n_frame = self._model.simulator, group.n_rigid, group.position.shape[1]
        body = np.diff(group.position[0, H - 1 :, :n], axis=0)
        position, velocity = history_of(group, 0, H - 1)
        simulator.step(position, velocity, 0 * body[0], group.context_at(H, 0), n)  # type: ignore[call-arg]  # warm-up
        positions = np.full((1, n_frame - H, *position.shape), np.nan)
        forces = None
        if group.force is not None:
            forces = np.full((1, n_frame - H, 3), np.nan, np.float32)
        edges, judgement = [], Judgement(RolloutStatus.OK)
        start = time.perf_counter()
        for k in range(n_frame - H):
            displacement, force, n_edge = simulator.step(  # type: ignore[call-arg]
                position, velocity, body[k], group.context_at(H + k, 0), n
            )
            position = position + displacement
            velocity = np.concatenate([velocity[1:], displacement[None]])
            if not (np.isfinite(position).all() and (force is None or np.isfinite(force).all())):
                judgement = Judgement(RolloutStatus.NON_FINITE, H + k, -1, 'not a number')
                break
            positions[0, k] = position
            if forces is not None:
                forces[0, k] = force
            edges.append(n_edge)
        self._edges[int(group.record[0])] = float(np.mean(edges)) if edges else 0.0
        return Rollout(positions, forces, [judgement], time.perf_counter() - start)

    def run(self, groups, split: str, progress=iter):
        """As `Evaluator.run`, with edges and memory in the metrics."""
        results, summary = super().run(groups, split, progress)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        for row in summary['runs']['model']:
            row |= {'edges': round(self._edges[row['record']]), 'peak_memory_mb': peak}
        summary['mean']['model']['peak_memory_mb'] = peak
        return results, summary | {'particles': self._model.simulator.scene.n_soil}
