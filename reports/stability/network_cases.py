"""The network in other precisions, and from perturbed starts: does a small error grow or decay?"""

import numpy as np
import tensorflow as tf

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout import rollout_inputs
from learning_to_simulate.subspace import graph_network
from learning_to_simulate.subspace.learned_simulator import SimulatorState
from reports.stability import shipped as lib
from reports.stability.cases import judged

PART = 'Precision and perturbed starts'
PRECISIONS = ('float64', 'bfloat16', 'float16')
# Of the standard deviation of each mode's motion per frame; noise in training is 0.5 of it (pcg).
AMPLITUDES = (1e-4, 1e-2, 1.0)


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
    rows, simulator, group = [], model.model.simulator, model.group
    layout = model.model.layout(group.n_rigid)
    state, known, context, _ = rollout_inputs(group, layout, simulator.scene)
    coming = None if known is None else known.at(0)
    coming = coming if simulator.knows_next_frame or simulator.rate_scaled else None
    nodes, edges = simulator.features(state, coming, context, layout)
    truth = group.position[:, H:, group.n_rigid :]
    own = np.sqrt((model.soil_rms(reference - truth) ** 2).mean())
    network = simulator._network
    try:
        for dtype in PRECISIONS:
            ends = layout.senders, layout.receivers
            simulator._network = CastNetwork(simulator, dtype, nodes, edges, ends)
            position, _, judgements = lib.roll(model, model.plain_function(), group)
            simulator._network = network
            away = model.soil_rms(position[:, :, group.n_rigid :] - reference)
            figure = float(np.sqrt((away**2).mean()) / own)
            note = f'error of float32 {1e3 * own:.3g} mm; {lib.worst(judgements)}'
            name = f'{model.name}: network in {dtype}: distance from float32 over its own error'
            # Below a tenth nobody sees it; measured 3e-6 for the excavation's pcg.
            limit = 0.1 if dtype == 'float64' else None
            rows.append(judged(PART, name, figure, '', limit, note))
    finally:
        simulator._network = network
    return rows


def perturbations(model, function, reference):
    """Rows and curves of starts with noise on modes: growth rate per second and final size."""
    rows, curves = [], []
    group, simulator = model.group, model.model.simulator
    layout = model.model.layout(group.n_rigid)
    inputs = rollout_inputs(group, layout, simulator.scene)
    truth = group.position[:, H:, group.n_rigid :]
    own = np.sqrt((model.soil_rms(reference - truth) ** 2).mean())
    std = simulator.statistics.velocity_std[1:]
    # The published presets keep one scale for all modes: take each mode's own, from the records.
    std = np.maximum(group.velocity[:, :, group.n_rigid :].std(axis=(0, 1)), 1e-3 * std)
    for amplitude in AMPLITUDES:
        draw = np.random.default_rng(0).standard_normal(inputs[0].velocity.shape)
        draw[:, : group.n_rigid] = 0.0
        draw[:, group.n_rigid :] *= amplitude * std[:, None]
        state = inputs[0]
        state = SimulatorState(
            state.offset + draw.sum(axis=2).astype(np.float32),
            state.velocity + draw.astype(np.float32),
        )
        offsets, _ = function(state, *inputs[1:])
        position = np.moveaxis(offsets.numpy(), 0, 1) + layout.origin
        away = model.soil_rms(position[:, :, group.n_rigid :] - reference)
        size = np.sqrt((away**2).mean(axis=0))
        frames = H + np.arange(len(size))
        seconds = frames * simulator.scene.dt
        rate = np.polyfit(seconds, np.log(np.maximum(size, 1e-12)), 1)[0]
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
        rows.append(judged(PART, name, float(rate), 'per second', None, note))
    return rows, curves


def run_all(is_quick, progress):
    """All rows and the curves by name."""
    rows, curves = [], []
    presets = ('pcg',) if is_quick else lib.PRESETS
    jobs = [(scene, preset) for scene in lib.SCENES for preset in presets]
    for scene, preset in progress(jobs[:1] if is_quick else jobs):
        model = lib.load(scene, preset, 1 if is_quick else None)
        function = model.plain_function()
        position, _, _ = lib.roll(model, function, model.group)
        reference = position[:, :, model.group.n_rigid :]
        rows += precisions(model, reference)
        new, curve = perturbations(model, function, reference)
        rows += new
        curves += curve
    return rows, {'perturbation': curves}
