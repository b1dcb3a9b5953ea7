"""What a model leaves out for its scene, in TensorFlow and in C: the items of `explain`."""

import dataclasses
from functools import partial

import numpy as np
import tensorflow as tf

from learning_to_simulate import connectivity_utils, reading_utils, registry
from learning_to_simulate.native import model_data
from learning_to_simulate.rollout import RolloutFunction, rollout_inputs
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import method
from learning_to_simulate.subspace.features import EMBEDDING_SIZE
from learning_to_simulate.subspace.learned_simulator import Layout
from reports import timing

_TRANSPOSED = {'MatMul': 'transpose_a', 'BatchMatMulV2': 'adj_x'}


@dataclasses.dataclass
class Item:
    """One thing that is left out, and what there would be on top without it."""

    name: str
    edges: int | None = None
    mflop: float | None = None  # per step
    weights: int | None = None
    # Names of the rollouts without and with it; None: it cannot be switched alone.
    variants: tuple[str, str] | None = None
    us_per_step: float | None = None  # time that it saves


class Explanation:
    """The items of a trained graph network, by the first test run of its dataset.
    FileNotFoundError, ValueError: no model or data there, they do not belong together, or the model
    has no graph."""

    def __init__(self, model_path: str, data_path: str):
        opened = registry.open_model(model_path, data_path, 'test')
        model, metadata, groups = opened.model, opened.metadata, opened.groups
        self._simulator = simulator = model.simulator
        self.n_weight = _weights(simulator)
        if not simulator.config.has_graph:
            raise ValueError(f'{model_path}: model {simulator.config.model!r} has no graph')
        self._calls: dict[str, tuple] = {}
        group = groups[0].select(0)
        self.layout = layout = model.layout(group.n_rigid)
        inputs = self._add('all', model, group, layout)
        self.mflop = plain_frame(simulator, layout, *inputs[:3])
        self.items = [
            *self._edges(model, group),
            *self._rigid_particles(model, data_path, metadata, group),
            *self._modes(model, data_path, metadata, group),
            *self._folded(),
            *self._absent(),
        ]

    def _add(self, name, model, group, layout):
        """Makes a variant to be timed; returns its inputs."""
        function = RolloutFunction(model.simulator, layout)
        inputs = rollout_inputs(group, layout, model.simulator.scene)
        self._calls[name] = (function, inputs)
        return inputs

    def _on_top(self, name, variant, model, group, layout):
        """An item that is switched off by another graph."""
        inputs = self._add(variant, model, group, layout)
        mflop = plain_frame(model.simulator, layout, *inputs[:3])
        return Item(
            name,
            layout.n_edge - self.layout.n_edge,
            mflop - self.mflop,
            _weights(model.simulator) - self.n_weight,
            (variant, 'all'),
        )

    def _edges(self, model, group):
        layout, s = self.layout, model.simulator
        if layout.n_edge == layout.n_node**2:
            return
        full = connectivity_utils.build('fully_connected', model.simulator.scene, layout.n_rigid)
        full = Layout(full, group.n_rigid, s.scene, s.statistics, s.config)
        yield self._on_top('edges that the graph does not have', 'full', model, group, full)

    def _rigid_particles(self, model, data_path, metadata, group):
        modes = model.simulator.config.modes
        whole = reading_utils.read_groups(data_path, 'test', metadata, modes=modes)
        (whole,) = (g.take(np.flatnonzero(g.record == group.record[0])) for g in whole
                    if group.record[0] in g.record)  # fmt: skip
        if whole.n_rigid == group.n_rigid:
            return
        name = f'rigid particles that are no nodes ({whole.n_rigid - group.n_rigid})'
        try:
            layout = model.layout(whole.n_rigid)
        except ValueError:  # The edges come from a file and fit one number of nodes only.
            yield Item(name)
            return
        yield self._on_top(name, 'whole body', model, whole, layout)

    def _modes(self, model, data_path, metadata, group):
        config = model.simulator.config
        left_out = metadata['mode_number'] - model.simulator.scene.n_modes
        if not left_out:
            return
        config = dataclasses.replace(config, modes=0)
        train, test = (
            reading_utils.read_groups(data_path, split, metadata, **config.nodes)
            for split in ('train', 'test')
        )
        motion = str(model.simulator.scene.rigid_motion)
        more = method.make_model(data_path, metadata, train, config, motion)
        whole = next(g for g in test if g.n_rigid == group.n_rigid).select(0)
        layout = more.layout(whole.n_rigid)
        yield self._on_top(f'modes that are no nodes ({left_out})', 'modes', more, whole, layout)

    def _folded(self):
        """What the C form folds away besides, by the shapes of the layers."""
        s, layout = self._simulator, self.layout
        width, steps = s.config.latent_size, s.config.message_passing_steps
        n_node, n_edge, n_rigid = layout.n_node, layout.n_edge, layout.n_rigid
        senders, receivers = len(set(layout.senders)), len(set(layout.receivers))
        per_node = 2 * width**2 * (2 * n_edge - senders - receivers) * steps
        yield Item('. ends of an edge per edge, not per node', 0, per_node / 1e6, 0)
        steps_of_c = model_data.network(s, layout)['steps']
        unused = sum(n_edge - step['n_edge'] for step in steps_of_c)
        if unused:
            yield Item('. edges that reach no output, of all steps', unused)
        rows = (n_node + n_edge) * (1 + steps)
        yield Item('. mean, scale, offset of LayerNorm (per element)', 0, 4 * width * rows / 1e6, 0)
        constant = 2 * EMBEDDING_SIZE * width * n_node
        yield Item('. embedding and means as features', 0, constant / 1e6, 0)
        yield Item('. last update of the edges (per element)', 0, n_edge * width / 1e6, 0)
        decoded = {RigidMotion.PRESCRIBED: 0, RigidMotion.DRIVEN: 1}
        kept = decoded.get(s.scene.rigid_motion, n_rigid * s.dim)
        if kept < n_rigid * s.dim:
            heads = 2 * width * (n_rigid * s.dim - kept)
            yield Item('. predictions of what is given of the body', 0, heads / 1e6, 0)

    def _absent(self):
        """What the scene lacks."""
        s, width = self._simulator, self._simulator.config.latent_size
        if not s.scene.has_force:
            head = 2 * width * s.dim * self.layout.n_node / 1e6
            yield Item('force: its head', 0, head, (width + 1) * s.dim)
        if not s.scene.context_names:
            yield Item('context: rows of the first layer')
        if not s.scene.rigid_motion.is_known:
            yield Item('coming motion of the body: rows of the first layer')

    def measure(self, rounds: int) -> dict:
        """Times `rounds` rollouts of all variants in turns, fills in the items and returns
        everything, JSON-able."""
        jobs = {
            name: timing.Job(partial(_first_output, function, inputs), inputs[-1])
            for name, (function, inputs) in self._calls.items()
        }
        us = {name: 1e3 * t.clock for name, t in timing.in_turns(jobs, rounds).items()}
        for item in self.items:
            if item.variants:
                off, on = (us[name] for name in item.variants)
                item.us_per_step = float(np.median(off - on))
        scene = self._simulator.scene
        return {
            'scene': scene.name,
            'rigid_motion': str(scene.rigid_motion),
            'nodes': self.layout.n_node,
            'edges': self.layout.n_edge,
            'weights': self.n_weight,
            'mflop_per_step': self.mflop,
            'us_per_step': float(np.median(us['all'])),
            'us_per_step_of_variants': {name: samples.tolist() for name, samples in us.items()},
            'items': [dataclasses.asdict(item) for item in self.items],
        }


def _first_output(function, inputs):
    """Calls a compiled rollout and waits for its positions."""
    function(*inputs)[0].numpy()


def _weights(simulator):
    return sum(int(np.prod(v.shape)) for v in simulator.trainable_variables)


def mflop(function, *arguments) -> float:
    """MFLOP of `function(*arguments)`, counted in its traced graph: of the matrix products that
    depend on its arguments, two for each multiply and add. Products of weights with weights are
    done once, not per frame; work element by element is small beside products."""
    graph = tf.function(function, autograph=False).get_concrete_function(*arguments).graph
    captured = {tensor.name for tensor in graph.internal_captures}
    moving = {tensor.name for tensor in graph.inputs} - captured
    total = 0
    for operation in graph.get_operations():
        if any(tensor.name in moving for tensor in operation.inputs):
            moving |= {tensor.name for tensor in operation.outputs}
            total += _flop(operation)
    return total / 1e6


def _flop(operation):
    if operation.type == 'Einsum':
        labels = operation.get_attr('equation').decode().split('->')[0].split(',')
        sizes = {}
        for names, tensor in zip(labels, operation.inputs, strict=True):
            sizes |= dict(zip(names, tensor.shape.as_list(), strict=True))
        return 2 * int(np.prod(list(sizes.values())))
    if operation.type not in _TRANSPOSED:
        return 0
    transposed = operation.get_attr(_TRANSPOSED[operation.type])
    inner = operation.inputs[0].shape[-2 if transposed else -1]
    return 2 * inner * operation.outputs[0].shape.num_elements()


def plain_frame(simulator, layout, state, known, context) -> float:
    """MFLOP of a frame of `LearnedSimulator.step`; `state` ... of `rollout.rollout_inputs`."""
    coming = None if known is None else known.at(0)
    if context is not None and context.shape.rank == 3:  # it changes in time
        context = context[0]
    return mflop(lambda *x: simulator.step(*x, layout), state, coming, context)
