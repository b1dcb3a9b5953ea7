"""Training of both networks: particles drawn from frames of episodes, and all frames for the force.

Every draw is a function of (seed, step). Runs count alike in the loss, whether much or little soil
moves in them, so that each is learned to about the same share of its motion. With the errors e of
displacements and of loads, D = `tool.displacement`, and the probability p with which a particle was
drawn of n (numbers of docs/swept_field.md),

  L_soil = sum over members of the mean of |e / D|^2 / (n p) / max(rms motion, LEAST_MOTION)   (16)
  L_load = sum over members of the mean of |e|^2 `Tool.target_weights`                         (17)
"""

import numpy as np
import tensorflow as tf
import tqdm

from learning_to_simulate import reading_utils
from learning_to_simulate.swept_field import episodes as episodes_lib
from learning_to_simulate.swept_field.calibration import CONDITIONS, USUAL
from learning_to_simulate.swept_field.field import SweptField
from learning_to_simulate.swept_field.network import stacked
from learning_to_simulate.tool import bed, for_scene
from learning_to_simulate.tool.axes import Axes
from learning_to_simulate.tool.blade import FORCE
from pca_tools import dataset
from pca_tools.subspace import Subspace

# A run that moves less than this (root mean square) weighs no more than one that does, m.
LEAST_MOTION = 0.003
# A particle that ever moves so far is drawn more often, m; the others show that they rest.
MOVED = 0.001
MOVER_SHARE = 0.85
LOAD_BATCH = 1024
PARTICLES = 48  # drawn of the sample of each frame of a batch
CLIP_NORM = 1.0
_SOIL_STREAM, _LOAD_STREAM, _PARTICLE_STREAM = 1, 2, 3


class TrainingData:
    """Episodes as tensors.

    Args:
      episodes: list of `episodes.Episode`, of one number of particles.
      frames: of `episodes.frames_of`.
      field: `SweptField`, for its tool and inputs.
    """

    def __init__(self, episodes, frames, field):
        model, tool = field.network, field.tool
        sampled = [f.at(e.frames) for f, e in zip(frames, episodes, strict=True)]
        self.bins, self.scalars = stacked(sampled)
        self.moved = np.concatenate([e.moved for e in episodes])
        self.episode = np.repeat(np.arange(len(episodes)), [len(e.frames) for e in episodes])
        self.rest = np.stack([e.ground.local for e in episodes])
        motion = np.array([np.sqrt((e.moved**2).mean()) for e in episodes])
        weight = 1.0 / np.maximum(motion, LEAST_MOTION)
        self.weight = (weight / weight.mean()).astype(np.float32)
        is_mover = np.stack([(e.moved**2).sum(-1).max(0) > MOVED**2 for e in episodes])
        count = is_mover.sum(axis=1, keepdims=True)
        n = is_mover.shape[1]
        share = np.where(count > 0, MOVER_SHARE * is_mover / np.maximum(count, 1), 0.0)
        share += np.where(count > 0, 1.0 - MOVER_SHARE, 1.0) / n
        self.logits = np.log(share).astype(np.float32)
        self.importance = (1.0 / (n * share)).astype(np.float32)
        weight = np.stack([tool.target_weights(e) for e in episodes])
        of_frame = np.repeat(weight, [len(e.load) for e in episodes], axis=0)
        # Inputs of the loads are few enough to be computed once; frames in the air teach nothing.
        share = np.concatenate([model.inputs.load_share(*f).numpy() for f in frames])
        there = share[:, 0] > 0
        self.load_share = share[there]
        self.load_seen = np.concatenate([model.inputs.force(*f).numpy() for f in frames])[there]
        self.load = np.concatenate([tool.targets(e) for e in episodes])[there]
        of_frame /= FORCE**2 * of_frame[:, 0].mean()
        self.load_weight = of_frame.astype(np.float32)[there]


def make_field(config, data_path: str, metadata: dict) -> SweptField:
    """A field with fresh weights for a dataset.

    Raises:
      FileNotFoundError: no runs, subspace or particle sample.
      ValueError: see `tool.for_scene`.
    """
    groups = reading_utils.read_groups(data_path, 'train', metadata)
    scene = reading_utils.read_scene(data_path, metadata, groups, None)
    scene.check_one_body('the method swept_field')
    tool = for_scene(scene)
    axes = Axes.of_runs(dataset.read_split(data_path, 'train'), scene.up_axis)
    rest = Subspace.load(f'{data_path}/subspace.npz').initial
    return SweptField(
        config, scene, axes, tool.grid, tool, rest, *bed.spacings(rest, metadata)
    )


def fit(config, data_path: str, metadata: dict) -> tuple[SweptField, dict]:
    """Trains a field on the train runs of a dataset.

    Returns:
      the field with the ranges of its training, and facts of the training: episodes, runs, losses,
      and those of `left_out`.

    Raises:
      see `make_field` and `Trainer.run`.
    """
    tf.keras.utils.set_random_seed(config.seed)
    field = make_field(config, data_path, metadata)
    reader = episodes_lib.EpisodeReader(data_path, metadata, field)
    episodes = reader.read('train', config.start_every, config.train_runs)
    frames = episodes_lib.frames_of(episodes, field.tool, field.grid, field.scene.dt)
    facts = Trainer(field.network, config, TrainingData(episodes, frames, field)).run()
    dt = field.scene.dt
    field.ranges = ranges_of(
        field, np.concatenate([field.judged(e.path, f, dt) for e, f in zip(episodes, frames)])
    )
    facts |= {
        'episodes': len(episodes),
        'runs': len({e.record for e in episodes}),
        'force_mean': field.axes.world_loads(
            np.concatenate([e.load for e in episodes if not e.start]).mean(axis=0)
        )[0].tolist(),
        **left_out(field, episodes, frames),
    }
    return field, facts


def ranges_of(field, values) -> dict[str, list[float]]:
    """Ranges of scalars and conditions [T, J] of training, at least those of `USUAL`."""
    names = (*field.tool.scalars, *CONDITIONS)
    low, high = values.min(axis=0).tolist(), values.max(axis=0).tolist()
    ranges = dict(zip(names, map(list, zip(low, high)), strict=True))
    for name in ranges.keys() & USUAL:
        (low, high), (least, most) = ranges[name], USUAL[name]
        ranges[name] = [min(low, least), max(high, most)]
    return ranges


def left_out(field, episodes, frames) -> dict[str, float]:
    """What the field leaves out of episodes, since it says that it cannot have moved.

    Returns:
      `left_out_share` of all particles in all frames, `left_out_rms_mm`, their displacement in
      truth, and `left_out_motion`, their share of all squared displacements.
    """
    count, number, square, whole = 0, 0, 0.0, 0.0
    for episode, frame in zip(episodes, frames, strict=True):
        rests = ~field.may_move(frame.at(episode.frames), episode.ground.local)
        size = (episode.moved.astype(np.float64) ** 2).sum(axis=-1)
        count, number = count + int(rests.sum()), number + rests.size
        square, whole = square + float(size[rests].sum()), whole + float(size.sum())
    return {
        'left_out_share': count / number,
        'left_out_rms_mm': 1e3 * float(np.sqrt(square / max(3 * count, 1))),
        'left_out_motion': square / max(whole, 1e-30),
    }


class Trainer:
    """Trains a `network.FieldNetwork`.

    Args:
      model: the network.
      config: `SweptFieldConfig`.
      data: `TrainingData`.
    """

    def __init__(self, model, config, data: TrainingData):
        self._model, self._config, self._data = model, config, data
        schedule = tf.keras.optimizers.schedules.CosineDecay(
            config.learning_rate, config.num_steps, warmup_target=None
        )
        # Each part has an optimiser of its own: neither gradient is clipped by the other's.
        self._optimizers = []
        for part in (model.soil, model.load):
            optimizer = tf.keras.optimizers.Adam(schedule, global_clipnorm=CLIP_NORM)
            optimizer.build(part.trainable_variables)
            self._optimizers.append(optimizer)
        self._step = tf.function(self._train_step, autograph=False)

    def run(self, progress=True) -> dict[str, float]:
        """Trains to the end; returns the mean losses of the last tenth.

        Raises:
          ValueError: a loss that is not finite.
        """
        config, data = self._config, self._data
        late = []
        bar = tqdm.trange(config.num_steps, unit='step', disable=None if progress else True)
        for step in bar:
            rng = np.random.Generator(
                np.random.Philox(key=config.seed, counter=[0, 0, _SOIL_STREAM, step])
            )
            # The same number of frames of every episode, in the long run.
            picks = rng.integers(len(data.episode), size=config.batch_size)
            loads = rng.integers(len(data.load), size=LOAD_BATCH)
            episode = data.episode[picks]
            losses = self._step(
                tf.constant([config.seed, step], tf.int32),
                tf.constant(data.bins[picks]),
                tf.constant(data.scalars[picks]),
                tf.constant(data.rest[episode]),
                tf.constant(data.moved[picks]),
                tf.constant(data.logits[episode]),
                tf.constant(data.importance[episode] * data.weight[episode, None]),
                tf.constant(data.load_seen[loads]),
                tf.constant(data.load_share[loads]),
                tf.constant(data.load[loads]),
                tf.constant(data.load_weight[loads]),
            )
            if step % 50 == 0 or step >= 0.9 * config.num_steps:
                values = [float(loss) for loss in losses]
                if not np.isfinite(values).all():
                    raise ValueError(f'losses of soil and force are {values} at step {step}')
                bar.set_postfix(soil=f'{values[0]:.3g}', force=f'{values[1]:.3g}')
                if step >= 0.9 * config.num_steps:
                    late.append(values)
        soil, load = np.mean(late, axis=0) if late else values
        return {'loss_soil': float(soil), 'loss_force': float(load)}

    def _train_step(self, seed, bins, scalars, rest, moved, logits, weight, *loads):
        drawn = tf.random.stateless_categorical(logits, PARTICLES, seed, dtype=tf.int32)
        rest, moved, weight = (tf.gather(x, drawn, batch_dims=1) for x in (rest, moved, weight))
        seen, share, load, load_weight = loads
        losses = []
        with tf.GradientTape() as tape:
            error = self._model.displacement(bins, scalars, rest) - moved
            square = tf.reduce_sum((error / self._model.inputs.displacement) ** 2, axis=-1)
            # Summed over members, which know nothing of each other.
            losses.append(tf.reduce_sum(tf.reduce_mean(square * weight, axis=(1, 2))))
        self._apply(tape, losses[0], self._model.soil, self._optimizers[0])
        with tf.GradientTape() as tape:
            error = self._model.load_of(seen, share) - load
            square = tf.reduce_sum(error**2 * load_weight, axis=-1)
            losses.append(tf.reduce_sum(tf.reduce_mean(square, axis=1)))
        self._apply(tape, losses[1], self._model.load, self._optimizers[1])
        return [loss / self._config.members for loss in losses]

    def _apply(self, tape, loss, part, optimizer):
        variables = part.trainable_variables
        optimizer.apply_gradients(zip(tape.gradient(loss, variables), variables, strict=True))
