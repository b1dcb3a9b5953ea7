"""The full-space baseline on disk: runs of particles, training, rollouts; see the package.

A run has every k-th soil particle of the dataset beside all rigid particles.
"""

import dataclasses
import os
import resource
import time

import numpy as np
import tensorflow as tf

from learning_to_simulate import checkpoints, evaluation, reading_utils
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.config import FullSpaceConfig
from learning_to_simulate.full_space.simulator import (
    ParticleSimulator,
    ParticleStatistics,
    ParticleStep,
    compute_statistics,
    typical_radius,
)
from learning_to_simulate.live import starts
from learning_to_simulate.live.soil import Particles
from learning_to_simulate.reading_utils import RunGroup, context_of
from learning_to_simulate.registry import OpenedModel
from learning_to_simulate.rollout import Rollout
from learning_to_simulate.rollout_status import judge
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.training import loop
from learning_to_simulate.training.schedule import GradientTraining, check_window, mean_of
from pca_tools import dataset
from pca_tools.raw_runs import RawRuns
from pca_tools.subspace import Subspace

SOIL_TYPE = 6  # of the authors' records
RAW, DECODED = 'raw runs', 'decoded from the subspace'
Step = ParticleStep  # of `registry`
_WINDOW_STREAM, _EVALUATION_STREAM = 11, 12


def read_runs(data_path, raw_path, split, metadata, soil_particles) -> RunGroup:
    """All runs of a split as one group of V = R + kept soil particles (about `soil_particles`),
    from the folder of the raw runs of its cases, or (None) decoded from the records.

    Raises:
      FileNotFoundError: no such split, raw folder or subspace.
      ValueError: raw runs that lack a case of the split or differ from the dataset, records with
        other numbers of rigid particles or frames, or without a subspace.
    """
    records = dataset.read_split(data_path, split)
    soils = _decoded_soil(data_path, records)
    if raw_path:
        soils = _raw_soil(raw_path, metadata, data_path, split, records)
    positions = []
    for i, (run, soil) in enumerate(zip(records, soils)):
        if soil_particles > soil.shape[1]:
            raise ValueError(
                f'soil_particles is {soil_particles}, but the runs have {soil.shape[1]} soil '
                f'particles'
            )
        kept = slice(None, None, max(round(soil.shape[1] / soil_particles), 1))
        rigid = run.position[:, : run.n_rigid].astype(np.float64)
        positions.append(np.concatenate([rigid, soil[:, kept]], axis=1))
        if positions[-1].shape != positions[0].shape or run.n_rigid != records[0].n_rigid:
            raise ValueError(
                f'{data_path}: {split} record {i} has {run.n_rigid} rigid particles and '
                f'{len(run.position)} frames, unlike those before: full_space takes equal runs only'
            )
    first = records[0]
    n_soil = positions[0].shape[1] - first.n_rigid
    return RunGroup(
        n_rigid=first.n_rigid,
        particle_type=np.append(first.particle_type[: first.n_rigid], [SOIL_TYPE] * n_soil),
        position=np.stack(positions),
        force=None if first.force is None else np.stack([r.force for r in records]).astype(float),  # type: ignore[misc]
        context=context_of(records),
        record=np.arange(len(records)),
    )


def _decoded_soil(data_path, records):
    path = os.path.join(data_path, 'subspace.npz')
    if not os.path.isfile(path):
        raise FileNotFoundError(
            f'{path}: no such file; without a subspace full_space needs the raw runs (--raw_path)'
        )
    space = Subspace.load(path)
    yield from (space.decode(run.position[:, run.n_rigid :]) for run in records)


def _raw_soil(raw_path, metadata, data_path, split, records):
    """Soil particles of the raw run of each record, checked against it."""
    raw = RawRuns(raw_path)
    cases = [entry['case'] for entry in metadata.get('cases', {}).get(split, [])]
    if len(cases) != len(records):
        raise ValueError(
            f'metadata.json names {len(cases)} cases of {split} for {len(records)} records: raw '
            f'runs cannot be found for them'
        )
    if lacking := sorted(set(cases) - set(raw.cases)):
        raise ValueError(f'{raw_path}: lacks the runs of the {split} cases {lacking}')
    for i, (case, record) in enumerate(zip(cases, records)):
        run, body = raw[raw.cases.index(case)], record.position[:, : record.n_rigid]
        if run.rigid_positions.shape != body.shape or not np.allclose(
            run.rigid_positions, body, atol=1e-5
        ):
            raise ValueError(
                f'{raw_path}: the body of case {case} does not move as in {split} record {i} of '
                f'{data_path}: the raw runs are of another dataset'
            )
        yield run.positions.astype(np.float64)


class ParticleTrainer(GradientTraining):
    """Single steps with random-walk noise: holds one `RunGroup` of particles, the optimiser and one
    compiled step; batches are made on the host. ValueError: runs shorter than a window."""

    def __init__(self, model, group):
        super().__init__(model.simulator, clip_norm=1.0)
        check_window([group], H + 1)
        self._group = group
        self._compiled = tf.function(self._train_step, autograph=False, reduce_retracing=True)

    def step(self, step: int) -> dict[str, tf.Tensor]:
        rng = self.generator(_WINDOW_STREAM, step)
        windows = self._windows(rng, self.config.batch_size)
        batch = self._batch([self._sample(run, start, self._walk(rng)) for run, start in windows])
        return self._compiled(tf.constant(step, tf.float32), *batch)

    def batch_of(self, step: int) -> list[tuple[int, int]]:
        """(record, first frame) of each window of training step `step`."""
        rng = self.generator(_WINDOW_STREAM, step)
        windows = self._windows(rng, self.config.batch_size)
        return [(int(self._group.record[run]), start) for run, start in windows]

    def one_step_errors(self, n_batch: int = 20) -> dict[str, float]:
        """Mean one-step losses without noise over random windows."""
        rows = []
        for i in range(n_batch):
            windows = self._windows(self.generator(_EVALUATION_STREAM, i), 4)
            rows.append(self._losses(*self._batch([self._sample(*window) for window in windows])))
        return mean_of(rows)

    def _windows(self, rng, size):
        n_run, n_frame = self._group.position.shape[:2]
        picks = rng.integers(n_run * (n_frame - H), size=size)
        return [divmod(int(pick), n_frame - H) for pick in picks]

    def _walk(self, rng):
        if not self.config.noise_std:
            return None
        return rng.normal(size=(H - 1, *self._group.position.shape[2:]))

    def _sample(self, run, start, walk=None):
        """Graph, target [V, D], weight [V, D] of its error, force [D] of one window; the random
        walk of the noise reaches `noise_std` in the last velocity (SG 2020, B.1)."""
        group, simulator, config = self._group, self.simulator, self.config
        s, scene, n = simulator.statistics, simulator.scene, self._group.n_rigid
        frames, coming_frame = group.position[run, start : start + H], start + H
        position, velocity = frames[-1], np.diff(frames, axis=0)
        coming = group.position[run, coming_frame] - position
        given = simulator.given_motion(coming[:n])
        rate = simulator.rate(given)
        if walk is not None:
            std = config.noise_std * rate * s.velocity_std[1]
            walk = walk.cumsum(axis=0) * std / np.sqrt(len(velocity))
            walk[:, :n] = 0.0
            position, velocity = position + walk.sum(axis=0), velocity + walk
        context = group.context_at(coming_frame, run)
        graph = simulator.inputs(position, velocity, given, context, n)
        target = coming / (rate * s.velocity_std[1])
        weight = np.full(target.shape, 1.0 / (len(target) - n))
        weight[:n] = 0.0
        if scene.rigid_motion == RigidMotion.DRIVEN:
            up = scene.up_axis
            height = (coming[:n, up] - velocity[-1, :n, up]).mean() / s.height_std[0]
            target[:n, up], weight[:n, up] = height, 1.0 / n
        force = np.zeros(simulator.dim)
        if scene.has_force:
            force = (group.force[run, coming_frame] - s.force_mean) / s.force_std
        return graph, target, weight, force

    def _batch(self, samples):
        """Graphs side by side as one, with the index of the body's particles [B, R]."""
        graphs, targets, weights, forces = zip(*samples)
        nodes, edges, senders, receivers = zip(*graphs)
        n_node, n = len(targets[0]), self._group.n_rigid or len(targets[0])
        first = np.arange(len(samples)) * n_node
        ends = (
            np.concatenate([end + shift for end, shift in zip(each, first)])
            for each in (senders, receivers)
        )
        rows = (np.concatenate(each) for each in (nodes, edges, targets, weights))
        nodes, edges, *others = (tf.constant(values, tf.float32) for values in rows)
        return (
            nodes, edges, *(tf.constant(end, tf.int32) for end in ends), *others,
            tf.constant(np.stack(forces), tf.float32),
            tf.constant(first[:, None] + np.arange(n), tf.int32),
        )  # fmt: skip

    def _losses(self, nodes, edges, senders, receivers, target, weight, force, body):
        predicted, forces = self.simulator.decode(nodes, edges, senders, receivers)
        n_graph = tf.cast(tf.shape(force)[0], tf.float32)
        motion = tf.reduce_sum((predicted - target) ** 2 * weight) / n_graph
        if forces is None:
            return {'loss': motion, 'loss_mse': motion}
        pooled = tf.reduce_mean(tf.gather(forces, body), axis=1)
        error = tf.reduce_sum((pooled - force) ** 2) / n_graph
        return {'loss': motion + error, 'loss_mse': motion, 'loss_force_mse': error}

    def _train_step(self, step, *batch):
        with tf.GradientTape() as tape:
            values = self._losses(*batch)
        self.apply(tape.gradient(values['loss'], self.simulator.trainable_variables), step)
        return values


@dataclasses.dataclass
class ParticleModel:
    """A `ParticleSimulator` as model folders and the training loop take it: its edges come and go,
    so it has none to store."""

    simulator: ParticleSimulator
    mode_mask: None = None
    loaded_mask: None = None
    edge_source: None = None

    def edge_counts(self) -> dict[str, int]:
        return {}

    def decoder(self, subspace=None) -> Particles:
        """Its nodes are particles; a subspace is not needed."""
        box = self.simulator.statistics.low, self.simulator.statistics.high
        return Particles(box, self.simulator.scene.up_axis)


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
    raw_path = options.raw_path
    metadata = dataset.read_metadata(data_path)
    has_valid = os.path.exists(dataset.split_path(data_path, 'valid'))
    by_split = {
        split: [read_runs(data_path, raw_path, split, metadata, config.soil_particles)]
        for split in (['train', 'valid'] if has_valid else ['train'])
    }
    (group,) = by_split['train']
    model = make_model(data_path, metadata, group, config, options.rigid_motion)
    source, scene = RAW if raw_path else DECODED, model.simulator.scene
    training = loop.Training(
        model=model,
        trainer=ParticleTrainer(model, group),
        evaluator=ParticleEvaluator(
            model, {} if raw_path else metadata, starts.largest_force([group])
        ),
        valid=by_split.get('valid', []),
        n_rigid=group.n_rigid,
        data={
            'path': data_path,
            'source': source,
            'sha256': checkpoints.digests(data_path, ['metadata.json']),
        },
        title=f'{config.preset} on {data_path} ({source}): {len(group.position)} runs, '
        f'{group.n_rigid} rigid and {scene.n_soil} soil particles, radius '
        f'{scene.connectivity_radius:.4g} m',
        write_files=lambda path: starts.write_parts(path, starts.of_groups(data_path, by_split)),
    )
    return loop.run(training, model_path, options)


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


def open_model(model_path, data_path, split, raw_path=None) -> OpenedModel:
    """A trained model with the runs of a split; see `registry`. ValueError for particles of another
    source or number, too."""
    model = load(model_path)
    scene, config = model.simulator.scene, model.simulator.config
    source = checkpoints.read_config(model_path)['data']['source']
    if source != (RAW if raw_path else DECODED):
        raise ValueError(
            f'{model_path} was trained on particles of {source}: '
            + ('give --raw_path' if source == RAW else 'leave --raw_path out')
        )
    metadata = dataset.read_metadata(data_path)
    group = read_runs(data_path, raw_path, split, metadata, config.soil_particles)
    if group.position.shape[2] - group.n_rigid != scene.n_modes:
        raise ValueError(
            f'{data_path} has {group.position.shape[2] - group.n_rigid} thinned soil particles, '
            f'the model in {model_path} was trained on {scene.n_modes}'
        )
    checkpoints.check_parts(model_path, scene, data_path, metadata)
    metadata = {} if raw_path else metadata
    return OpenedModel(
        model,
        [group],
        metadata,
        ParticleEvaluator(model, metadata, starts.read_force_limit(model_path)),
        lambda: ParticleTrainer(model, group).one_step_errors(),
    )


class ParticleEvaluator(evaluation.Evaluator):
    """As its base; the rows of the model also hold the peak memory of the process so far
    (`peak_memory_mb`). The metadata are {} for particles of raw runs, of which nothing is cut
    off."""

    def roll_out(self, group) -> Rollout:
        """Rolls out the one run of a group from its first H frames; stops where it blows up."""
        simulator, n, count = self._model.simulator, group.n_rigid, group.position.shape[1] - H
        step = ParticleStep(self._model, n)
        body = group.position[0, :, :n]
        positions = np.full((1, count, *group.position.shape[2:]), np.nan)
        forces = None
        if group.force is not None:
            forces = np.full((1, count, 3), np.nan, np.float32)
        step.reset(group.position[0, :H], group.context_at(H - 1, 0))
        edges, start = [], time.perf_counter()
        for k in range(count):
            coming, context = body[H + k], group.context_at(H + k, 0)
            position, force = step.propose(coming, coming - body[H + k - 1], context)
            positions[0, k] = position
            if forces is not None:
                forces[0, k] = force
            edges.append(step.edges)
            if not (np.isfinite(position).all() and (force is None or np.isfinite(force).all())):
                break
            step.accept()
        seconds = time.perf_counter() - start
        judgements = judge(
            group, positions, forces, simulator.statistics, simulator.scene, self._force_limit
        )
        return Rollout(positions, forces, judgements, seconds, round(np.mean(edges)))

    def run(self, groups, split: str, progress=iter):
        """As `Evaluator.run`, with the memory in the metrics."""
        results, summary = super().run(groups, split, progress)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        for row in summary['runs']['model']:
            row['peak_memory_mb'] = peak
        summary['mean']['model']['peak_memory_mb'] = peak
        return results, summary | {'particles': self._model.simulator.scene.n_soil}
