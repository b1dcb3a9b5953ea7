"""From a dataset to a trained swept field."""

import numpy as np
import tensorflow as tf

from learning_to_simulate import reading_utils
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.methods import resting_bed
from learning_to_simulate.methods.swept_field import episodes as episodes_lib
from learning_to_simulate.methods.swept_field import field as field_lib
from learning_to_simulate.methods.swept_field import tools, training
from learning_to_simulate.methods.swept_field.tool_path import Frame
from pca_tools import dataset
from pca_tools.subspace import Subspace


def make_field(config, data_path: str, metadata: dict) -> field_lib.SweptField:
    """A field with fresh weights for a dataset.

    Raises:
      FileNotFoundError: no runs, subspace or particle sample.
      ValueError: see `tools.for_scene`.
    """
    groups = reading_utils.read_groups(data_path, 'train', metadata)
    scene = reading_utils.read_scene(data_path, metadata, groups, None)
    scene.check_one_body('the method swept_field')
    tool = tools.for_scene(scene)
    axes = episodes_lib.find_axes(dataset.read_split(data_path, 'train'), scene.up_axis)
    space = Subspace.load(f'{data_path}/subspace.npz')
    rest = space.initial
    kept = resting_bed.kept_spacing(rest)
    first = next(iter(metadata.get('cases', {}).get('train', [])), {})
    return field_lib.SweptField(
        config, scene, axes, field_lib.GRIDS[tool.name], tool, rest, kept,
        resting_bed.solver_spacing(first) or kept,
    )  # fmt: skip


def reader_of(field, data_path: str, metadata: dict) -> episodes_lib.EpisodeReader:
    """Reads the episodes of a dataset as a field sees them."""
    beds = episodes_lib.BedReader(field.axes, field.grid, field.kept_spacing, field.spacing)
    return episodes_lib.EpisodeReader(data_path, metadata, beds, field.tool)


def fit(config, data_path: str, metadata: dict) -> tuple[field_lib.SweptField, dict]:
    """Trains a field on the train runs of a dataset.

    Returns:
      the field with the ranges of its training, and facts of the training: episodes, runs, losses,
      and those of `left_out`.

    Raises:
      see `make_field` and `training.Trainer.run`.
    """
    tf.keras.utils.set_random_seed(config.seed)
    field = make_field(config, data_path, metadata)
    reader = reader_of(field, data_path, metadata)
    episodes = reader.read('train', config.start_every, config.train_runs)
    frames = episodes_lib.frames_of(episodes, field.tool, field.grid, field.scene.dt)
    facts = training.Trainer(
        field.network, config, training.TrainingData(episodes, frames, field)
    ).run()
    scalars = np.concatenate([f.scalars for f in frames])
    field.ranges = {
        name: [float(scalars[:, i].min()), float(scalars[:, i].max())]
        for i, name in enumerate(field.tool.scalars)
    }
    facts |= {
        'episodes': len(episodes),
        'runs': len({e.record for e in episodes}),
        'force_mean': field.axes.world_loads(
            np.concatenate([e.load for e in episodes if not e.start]).mean(axis=0)
        )[0].tolist(),
        **left_out(field, episodes, frames),
    }
    return field, facts


def left_out(field, episodes, frames) -> dict[str, float]:
    """What the field leaves out of episodes, since it says that it cannot have moved.

    Returns:
      `left_out_share` of all particles in all frames, `left_out_rms_mm`, their displacement in
      truth, and `left_out_motion`, their share of all squared displacements.
    """
    count, number, square, whole = 0, 0, 0.0, 0.0
    for episode, frame in zip(episodes, frames, strict=True):
        chosen = Frame(frame.bins[episode.frames], frame.scalars[episode.frames])
        rests = ~field.may_move(chosen, episode.local_rest)
        size = (episode.moved.astype(np.float64) ** 2).sum(axis=-1)
        count, number = count + int(rests.sum()), number + rests.size
        square, whole = square + float(size[rests].sum()), whole + float(size.sum())
    return {
        'left_out_share': count / number,
        'left_out_rms_mm': 1e3 * float(np.sqrt(square / max(3 * count, 1))),
        'left_out_motion': square / max(whole, 1e-30),
    }


def sample_errors(field, reader, split: str, members=None) -> list[dict]:
    """Errors of each run of a split on its particle sample, from frame H on: soil (mm, root mean
    square per component) and force (relative L2) of the mean and of single members, and of soil
    that stays still."""
    episodes = reader.read(split)
    found = []
    for episode in episodes:
        _, frame = field.frames(episode.bed, episode.size, episode.pose, field.scene.dt)
        late = episode.frames >= H
        chosen = Frame(frame.bins[episode.frames], frame.scalars[episode.frames])
        moved = field.displacement(chosen, episode.local_rest, members)
        loads = field.loads(frame, members)[:, H:, :2]
        truth = episode.load[H:, :2]
        size = np.linalg.norm(truth)
        found.append(
            {
                'record': episode.record,
                'soil_mm': _rms(moved.mean(axis=0)[late] - episode.moved[late]),
                'soil_mm_of_members': [_rms(m[late] - episode.moved[late]) for m in moved],
                'still_mm': _rms(episode.moved[late]),
                'force_l2': float(np.linalg.norm(loads.mean(axis=0) - truth) / size),
                'force_l2_of_members': [float(np.linalg.norm(m - truth) / size) for m in loads],
            }
        )
    return found


def _rms(error):
    return float(1e3 * np.sqrt((error**2).mean()))
