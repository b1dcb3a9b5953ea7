"""The shipped networks in the subspace: ten times the horizon, error growth, rest, rigid shape; the
network in other precisions, and from perturbed starts."""

import dataclasses
import functools
import os

import numpy as np
import tensorflow as tf

from learning_to_simulate import metrics, reading_utils, registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout import RolloutFunction, rollout_inputs
from learning_to_simulate.rollout_status import RolloutStatus, judge
from learning_to_simulate.subspace import graph_network, subspace_model
from learning_to_simulate.subspace.learned_simulator import SimulatorState
from reports.record import ROOT
from reports.stability.cases import FLAGGED, HOLDS, Case, hold, judged, to_and_fro

LONG, NETWORK = 'Long rollouts', 'Precision and perturbed starts'
SCENES = ('excavation', 'wheel')
PRESETS = ('pcg', 'pcg_thesis', 'fcg_original')
HORIZON = 10
CONTINUATIONS = {'to and fro': to_and_fro, 'held at its end': hold}
# Every this many frames of a long rollout are kept for the pictures.
STRIDE = 10
PRECISIONS = ('float64', 'bfloat16', 'float16')
# Of the standard deviation of each mode's motion per frame; noise in training is 0.5 of it (pcg).
AMPLITUDES = (1e-4, 1e-2, 1.0)


@dataclasses.dataclass(eq=False)
class Shipped:
    """One shipped model with the test runs of its dataset.

    Attributes:
      name: scene and preset, as tables name the model.
      model: `subspace_model.Model`.
      group: the test runs, one `RunGroup`.
    """

    name: str
    model: subspace_model.Model
    group: reading_utils.RunGroup

    @property
    def scene(self):
        """Of the model."""
        return self.model.simulator.scene

    @property
    def truth(self):
        """Recorded modes [S, T - H, r, D], m."""
        return self.modes(self.group.position[:, H:])

    def modes(self, position):
        """Of nodes [..., V, D]."""
        return position[..., self.group.n_rigid :, :]

    @functools.cached_property
    def rollout(self) -> RolloutFunction:
        """The rollout of evaluations, compiled once for all parts of the report."""
        return self.function()

    def function(self, rigid_correction: bool = True) -> RolloutFunction:
        """A rollout that is compiled at its first call."""
        layout = self.model.layout(self.group.n_rigid)
        return RolloutFunction(self.model.simulator, layout, rigid_correction)

    def inputs(self, group=None):
        """Of the rollout function."""
        group = group or self.group
        return rollout_inputs(group, self.model.layout(group.n_rigid), self.scene)

    def roll(self, function, group=None):
        """Rolls out all runs as one batch: positions float64 [S, T - H, V, D], judgements."""
        group, simulator = group or self.group, self.model.simulator
        offsets, load = function(*self.inputs(group))
        position = np.moveaxis(offsets.numpy(), 0, 1).astype(np.float64) + function.layout.origin
        load = None if load is None else np.moveaxis(load.numpy(), 0, 1)
        return position, judge(group, position, load, simulator.statistics, simulator.scene)

    def rms(self, scores):
        """Root mean square over particles and axes of mode vectors [..., r, D], m: modes are
        orthonormal."""
        return np.sqrt((scores**2).sum(axis=(-1, -2)) / (scores.shape[-1] * self.scene.n_soil))

    def constant_velocity(self, n_frame: int):
        """Modes if the last given displacement went on, [S, n_frame, r, D]."""
        return metrics.constant_velocity(self.modes(self.group.position[:, :H]), n_frame)


@functools.cache
def load(scene: str, preset: str, n_run: int | None = None) -> Shipped:
    """Loads a shipped model and the first `n_run` test runs (None: all)."""
    data = os.path.join(ROOT, 'datasets', scene)
    opened = registry.open_model(os.path.join(ROOT, 'models', scene, preset), data, 'test')
    (group,) = opened.groups
    group = group.take(list(range(len(group.record))[:n_run]))
    return Shipped(f'{scene} {preset}', opened.model, group)


def resample(group, frames):
    """The group with its frames in another order, e.g. to and fro: what is given follows it.

    The first H frames must be the first H of the group. Predicted nodes past them are no inputs.
    """
    force = None if group.force is None else group.force[:, frames]
    return dataclasses.replace(
        group, position=group.position[:, frames], force=force, torque=None, body=None
    )


def worst(judgements) -> str:
    """How many runs are not OK, and the first frame of the first of the worst ones."""
    order = list(RolloutStatus)
    bad = [j for j in judgements if j.status != RolloutStatus.OK]
    if not bad:
        return 'all ok'
    first = min(bad, key=lambda j: (-order.index(j.status), j.frame))
    return (
        f'{len(bad)} of {len(judgements)} {first.status}, earliest frame {first.frame}, node '
        f'{first.node}'
    )


def long_rollout(model, function, factor, continuation):
    """Row and curve of all test runs over `factor` times the horizon: distance of the soil from its
    first frame, median over runs; the same for constant velocity."""
    n_frame = model.group.position.shape[1]
    length = H + factor * (n_frame - H)
    longer = resample(model.group, CONTINUATIONS[continuation](n_frame, length))
    position, judgements = model.roll(function, longer)
    start = model.modes(model.group.position[:, H - 1 : H])
    distance = model.rms(model.modes(position) - start)
    trivial = model.rms(model.constant_velocity(position.shape[1]) - start)
    # The farthest that the soil of any test run really moves within the data.
    farthest = model.rms(model.truth - start).max()
    statuses = [judgement.status for judgement in judgements]
    lost = [j.frame for j in judgements if j.status in ('left_bounds', 'non_finite')]
    body = f'body {continuation}' if model.scene.rigid_motion.is_known else 'body predicted'
    row = Case(
        LONG,
        f'{model.name}, {body}, {factor} x horizon: soil distance at the end over the true largest',
        float(np.median(distance[:, -1]) / farthest),
        '(median of the runs)',
        None,
        HOLDS if set(statuses) == {RolloutStatus.OK} else FLAGGED,
        f'{worst(judgements)}; x {np.median(trivial[:, -1]) / farthest:.3g} for constant '
        f'velocity, 0 for persistence',
    )
    keep = slice(None, None, STRIDE)
    curve = {
        'model': model.name,
        'continuation': continuation,
        'frames': np.arange(H, length)[keep],
        'distance_mm': 1e3 * np.median(distance, axis=0)[keep],
        'constant_velocity_mm': 1e3 * np.median(trivial, axis=0)[keep],
        'status': [str(status) for status in statuses],
        'time_to_failure_s': min(lost) * model.scene.dt if lost else None,
    }
    return row, curve


def error_growth(model, rolled):
    """Row of the error at the end over the best trivial predictor's there, and the curve of the
    soil error over the data, root mean square over runs, beside the trivial predictors, mm."""
    truth = model.truth
    methods = {
        'mm': rolled,
        'persistence_mm': model.modes(model.group.position[:, H - 1 : H]),
        'constant_velocity_mm': model.constant_velocity(truth.shape[1]),
    }
    curve = {
        name: 1e3 * np.sqrt((model.rms(modes - truth) ** 2).mean(axis=0))
        for name, modes in methods.items()
    }
    own, *trivial = (values[-1] for values in curve.values())
    half = curve['mm'][truth.shape[1] // 2]
    note = f'{own:.3g} mm at the end of the data, {half:.3g} mm half way; persistence '
    note += f'{trivial[0]:.3g}, constant velocity {trivial[1]:.3g} mm'
    name = f'{model.name}: error at the end of the data over that of the best trivial predictor'
    row = judged(LONG, name, float(own / min(trivial)), '', None, note)
    frames = H + np.arange(truth.shape[1])
    return row, {'model': model.name, 'frames': frames} | curve


def rest(model, function):
    """Row of a scene at rest: how far the soil drifts per frame when nothing moves."""
    group = model.group
    n_frame = group.position.shape[1] - H
    still = np.repeat(group.position[:, :1], H + n_frame, axis=1)
    still = dataclasses.replace(group, position=still, force=None, body=None)
    position, judgements = model.roll(function, still)
    modes = model.modes(position)
    drift = model.rms(modes[:, -1] - modes[:, 0]).max() / (n_frame - 1)
    usual = np.sqrt((model.rms(model.modes(group.velocity)) ** 2).mean())
    name = f'{model.name}: drift per frame of soil and body at rest over the RMS motion of the data'
    note = f'over {n_frame} frames; {worst(judgements)}'
    return judged(LONG, name, float(drift / usual), '', None, note)


def rigid_shape(model):
    """Rows of a predicted body with and without its correction."""
    group = model.group

    def edges(position):
        body = position[:, :, : group.n_rigid]
        return np.linalg.norm(body[..., :, None, :] - body[..., None, :, :], axis=-1)

    rows = []
    for correct in (True, False):
        position, _ = model.roll(model.function(correct))
        stretch = 1e3 * np.abs(edges(position) - edges(group.position[:, :1])).max()
        mse = metrics.rigid_mse(position, group.position[:, H:], group.n_rigid).mean()
        soil = np.sqrt((model.rms(model.modes(position) - model.truth) ** 2).mean())
        note = f'rigid MSE {1e4 * mse:.3g}e-4 m2, soil RMS {1e3 * soil:.3g} mm'
        way = 'with' if correct else 'without'
        name = f'{model.name}, {way} rigid correction: largest change of a distance in the body'
        # float32 positions of half a metre round at 3e-5 mm; measured 2e-4.
        rows.append(judged(LONG, name, float(stretch), 'mm', 2e-3 if correct else None, note))
    return rows


class CastNetwork:
    """The network of a model in another float type; state and statistics stay as they are.

    Args:
      simulator: the model whose weights are taken.
      dtype: of weights, inputs and products inside.
      nodes, edges: example inputs [B, V, F], [B, E, G] that fix the widths.
      ends: senders and receivers.
    """

    def __init__(self, simulator, dtype, nodes, edges, ends):
        config = simulator.config
        self._dtype = tf.as_dtype(dtype)
        self._network = graph_network.EncodeProcessDecode(
            config.latent_size,
            config.hidden_layers,
            config.message_passing_steps,
            output_size=simulator.dim * (2 if simulator.scene.has_force else 1),
            mean_aggregation=not config.is_published,
        )
        self(nodes, edges, *ends)
        weights = {v.name: v for v in simulator._network.trainable_variables}
        for variable in self._network.trainable_variables:
            name = next(n for n in weights if n.endswith(variable.name))
            variable.assign(tf.cast(weights[name], self._dtype))

    def __call__(self, nodes, edges, *graph):
        nodes, edges = (tf.cast(x, self._dtype) for x in (nodes, edges))
        return tf.cast(self._network(nodes, edges, *graph), tf.float32)


def precisions(model, reference):
    """Rows of the rollouts in other precisions against that in float32."""
    rows, simulator = [], model.model.simulator
    layout = model.model.layout(model.group.n_rigid)
    state, known, context, _ = model.inputs()
    coming = None if known is None else known.at(0)
    coming = coming if simulator.knows_next_frame or simulator.rate_scaled else None
    example = simulator.features(state, coming, context, layout)
    own = np.sqrt((model.rms(reference - model.truth) ** 2).mean())
    network = simulator._network
    for dtype in PRECISIONS:
        cast = CastNetwork(simulator, dtype, *example, (layout.senders, layout.receivers))
        simulator._network = cast
        try:
            position, judgements = model.roll(model.function())
        finally:
            simulator._network = network
        away = model.rms(model.modes(position) - reference)
        figure = float(np.sqrt((away**2).mean()) / own)
        note = f'error of float32 {1e3 * own:.3g} mm; {worst(judgements)}'
        name = f'{model.name}: network in {dtype}: distance from float32 over its own error'
        # Below a tenth nobody sees it; measured 3e-6 for the excavation's pcg.
        limit = 0.1 if dtype == 'float64' else None
        rows.append(judged(NETWORK, name, figure, '', limit, note))
    return rows


def perturbations(model, function, reference):
    """Rows and curves of starts with noise on modes: growth rate per second and final size."""
    rows, curves = [], []
    group, n = model.group, model.group.n_rigid
    layout = model.model.layout(n)
    state, *others = model.inputs()
    own = np.sqrt((model.rms(reference - model.truth) ** 2).mean())
    # The published presets keep one scale for all modes: take each mode's own, from the records.
    least = 1e-3 * model.model.simulator.statistics.velocity_std[1:]
    std = np.maximum(group.velocity[:, :, n:].std(axis=(0, 1)), least)
    for amplitude in AMPLITUDES:
        draw = np.random.default_rng(0).standard_normal(state.velocity.shape)
        draw[:, :n] = 0.0
        draw[:, n:] *= amplitude * std[:, None]
        start = SimulatorState(
            state.offset + draw.sum(axis=2).astype(np.float32),
            state.velocity + draw.astype(np.float32),
        )
        offsets, _ = function(start, *others)
        position = np.moveaxis(offsets.numpy(), 0, 1) + layout.origin
        size = np.sqrt((model.rms(model.modes(position) - reference) ** 2).mean(axis=0))
        frames = H + np.arange(len(size))
        rate = np.polyfit(frames * model.scene.dt, np.log(np.maximum(size, 1e-12)), 1)[0]
        curves.append(
            {
                'model': model.name, 'amplitude': amplitude, 'frames': frames, 'mm': 1e3 * size,
                'rate_per_s': rate, 'own_error_mm': 1e3 * own,
            }
        )  # fmt: skip
        grows = 'grows' if size[-1] > size[0] else 'decays'
        note = f'{1e3 * size[0]:.3g} mm after a frame, {1e3 * size[-1]:.3g} mm at the end '
        note += f'({grows}); own error {1e3 * own:.3g} mm'
        name = f'{model.name}: start off by {amplitude:g} of the motion: rate of the distance'
        rows.append(judged(NETWORK, name, float(rate), 'per second', None, note))
    return rows, curves


def run_rollouts(is_quick, progress):
    """All rows of long rollouts, and the curves by name."""
    rows: list[Case] = []
    curves: dict = {'horizon': [], 'growth': []}
    factor = 3 if is_quick else HORIZON
    for scene, preset in progress(_jobs(is_quick)):
        model = load(scene, preset, 1 if is_quick else None)
        function = model.rollout
        rolled, _ = model.roll(function)
        row, curve = error_growth(model, model.modes(rolled))
        rows.append(row)
        curves['growth'].append(curve)
        for continuation in CONTINUATIONS:
            if continuation == 'held at its end' and not model.scene.rigid_motion.is_known:
                continue  # nothing is given that could be continued in two ways
            row, curve = long_rollout(model, function, factor, continuation)
            rows.append(row)
            curves['horizon'].append(curve)
        rows.append(rest(model, function))
        if model.scene.rigid_motion == 'predicted':
            rows += rigid_shape(model)
    return rows, curves


def run_network(is_quick, progress):
    """All rows of precisions and perturbed starts, and the curves by name."""
    rows, curves = [], []
    for scene, preset in progress(_jobs(is_quick)):
        model = load(scene, preset, 1 if is_quick else None)
        function = model.rollout
        reference = model.modes(model.roll(function)[0])
        new, curve = perturbations(model, function, reference)
        rows += precisions(model, reference) + new
        curves += curve
    return rows, {'perturbation': curves}


def _jobs(is_quick):
    jobs = [(scene, preset) for scene in SCENES for preset in PRESETS]
    return jobs[:1] if is_quick else jobs
