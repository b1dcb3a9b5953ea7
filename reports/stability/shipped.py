"""Shipped models and datasets for the stability report, and rollouts of altered runs."""

import dataclasses
import os

import numpy as np

from learning_to_simulate import loads, metrics, reading_utils, registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout import RolloutFunction, rollout_inputs
from learning_to_simulate.rollout_status import RolloutStatus, judge
from learning_to_simulate.subspace import subspace_model
from reports.record import ROOT

SCENES = ('excavation', 'wheel')
PRESETS = ('pcg', 'pcg_thesis', 'fcg_original')


@dataclasses.dataclass
class Shipped:
    """One shipped model with the test runs of its dataset.

    Attributes:
      scene: name of the scene.
      preset: name of the preset.
      model: `subspace_model.Model`.
      metadata: of the dataset.
      group: the test runs, one `RunGroup`.
    """

    scene: str
    preset: str
    model: subspace_model.Model
    metadata: dict
    group: reading_utils.RunGroup

    @property
    def name(self) -> str:
        """Scene and preset, as tables name the model."""
        return f'{self.scene} {self.preset}'

    def function(self, rigid_correction: bool = True):
        """The rollout of evaluations, compiled at its first call."""
        layout = self.model.layout(self.group.n_rigid)
        return RolloutFunction(self.model.simulator, layout, rigid_correction)

    def plain_function(self) -> RolloutFunction:
        """The rollout by `LearnedSimulator.step`, which takes any network."""
        return RolloutFunction(self.model.simulator, self.model.layout(self.group.n_rigid))

    def soil_rms(self, scores):
        """RMS over particles and axes of mode vectors [..., r, D], m: modes are orthonormal."""
        n_soil = self.model.simulator.scene.n_soil
        return np.sqrt((scores**2).sum(axis=(-1, -2)) / (scores.shape[-1] * n_soil))


def load(scene: str, preset: str, n_run: int | None = None) -> Shipped:
    """Loads a shipped model and the first `n_run` test runs (None: all)."""
    path = os.path.join(ROOT, 'models', scene, preset)
    data = os.path.join(ROOT, 'datasets', scene)
    opened = registry.open_model(path, data, 'test')
    model, metadata, groups = opened.model, opened.metadata, opened.groups
    if len(groups) != 1:
        raise ValueError(f'{data}: test runs of {len(groups)} sizes, one was expected')
    runs = range(len(groups[0].record))[:n_run]
    return Shipped(scene, preset, model, metadata, groups[0].take(list(runs)))


def resample(group, frames):
    """The group with its frames in another order, e.g. to and fro: what is given follows it.

    The first H frames must be the first H of the group. Predicted nodes past them are no inputs.
    """
    force = None if group.force is None else group.force[:, frames]
    return dataclasses.replace(
        group, position=group.position[:, frames], force=force, torque=None, body=None
    )


def to_and_fro(n_frame: int, length: int):
    """Frame numbers 0 .. T-1 and back and so on, `length` of them."""
    return (n_frame - 1) - np.abs((n_frame - 1) - np.arange(length) % (2 * (n_frame - 1)))


def hold(n_frame: int, length: int):
    """Frame numbers 0 .. T-1, then the last one for ever."""
    return np.minimum(np.arange(length), n_frame - 1)


def roll(shipped: Shipped, function, group):
    """Rolls out all runs of a group as one batch.

    Returns:
      positions float64 [S, T - H, V, D], forces [S, T - H, D] or None, judgements.
    """
    simulator = shipped.model.simulator
    offsets, load = function(*rollout_inputs(group, function.layout, simulator.scene))
    position = np.moveaxis(offsets.numpy(), 0, 1).astype(np.float64) + function.layout.origin
    load = None if load is None else np.moveaxis(load.numpy(), 0, 1)
    judgements = judge(group, position, load, simulator.statistics, simulator.scene)
    return position, loads.split(load, simulator.statistics)[0], judgements


def worst(judgements):
    """How many runs are not OK, and the first frame of the first of the worst ones, in words."""
    order = list(RolloutStatus)
    bad = [j for j in judgements if j.status != RolloutStatus.OK]
    if not bad:
        return 'all ok'
    first = min(bad, key=lambda j: (-order.index(j.status), j.frame))
    return (
        f'{len(bad)} of {len(judgements)} {first.status}, earliest frame {first.frame}, node '
        f'{first.node}'
    )


def constant_velocity(group, n_frame: int):
    """Mode positions if the last given displacement went on, [S, n_frame, r, D]."""
    return metrics.constant_velocity(group.position[:, :H, group.n_rigid :], n_frame)
