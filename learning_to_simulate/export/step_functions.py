"""The exported functions of a model in a subspace, `step` and `reconstruct`, and their files.

A step takes the state that the model has in Python, float32 offsets from `origin` and the last
displacements, and gives the next one. Positions themselves do not fit into float32.

Each writer of a format takes the concrete functions by name, the variables that they hold and a
folder, and returns a function that loads what it wrote: name -> a function of named arrays that
gives a dict. A SavedModel has a signature for each function, LiteRT and ONNX have a file for each.
"""

import functools
import os
import pathlib
import time

import numpy as np
import tensorflow as tf
from tensorflow.python.framework import convert_to_constants

from learning_to_simulate import registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.config import TrainConfig
from learning_to_simulate.rollout import corrected_step
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace.learned_simulator import SimulatorState, initial_state
from learning_to_simulate.subspace.rigid_body import known_motion, shape_of
from pca_tools import files, subspace

COMPARED_STEPS = 8
# Largest difference to the source as a share of the largest motion or load of the compared calls.
# Measured 4e-7 (excavation) to 2e-6 (wheel): float32 sums in another order.
TOLERANCE = 1e-4
# Of particles, m; float32 positions of a metre resolve 1e-7.
PARTICLES_TOLERANCE = 2e-6
MEANING = {
    'offset': 'position of the nodes minus origin, m',
    'velocity': 'their last displacements [V, H - 1, D], newest last, m/frame',
    'rigid_offset': 'of the body in the coming frame; where only its height is predicted, at any '
    'height',
    'rigid_velocity': 'displacement of the body into that frame, m/frame',
    'context': 'context_names of the scene',
    'next_offset': 'offset in the coming frame',
    'next_velocity': 'velocity in the coming frame',
    'force': 'on the body, N',
    'modes': 'scores of the modes: origin + offset of the last nodes, m',
    'particles': 'of the soil, m',
}


class StepFunctions:
    """The functions that are exported of a model folder, for one graph of R rigid particles and r
    modes. The dataset gives the subspace for `reconstruct` (without one there is no such function)
    and a test run to compare on, of the largest body. ValueError for a model with a memory of the
    path; raises as `registry.open_model`."""

    def __init__(self, model_path: str, data_path: str):
        opened = registry.open_model(model_path, data_path, 'test')
        model, group = opened.model, max(opened.groups, key=lambda group: group.n_rigid)
        self._simulator, self._scene = model.simulator, model.simulator.scene
        if not isinstance(self._simulator.config, TrainConfig):
            raise ValueError(f'{model_path}: only networks in a subspace have an exported step')
        if self._simulator.config.reads_path:
            raise ValueError(
                'mode_order 0: an exported step has no memory of the path; use the stepper'
            )
        self._layout, self._group = model.layout(group.n_rigid), group.select(0)
        path, self._space = os.path.join(data_path, 'subspace.npz'), None
        if os.path.exists(path):
            self._space = model.fitting_subspace(subspace.Subspace.load(path))

    def step(self, offset, velocity, rigid_offset=None, rigid_velocity=None, context=None):
        """The coming frame, a predicted body kept rigid; arguments and results as of `MEANING`."""
        layout, known = self._layout, None
        if rigid_offset is not None:
            known = known_motion(rigid_offset[None], rigid_velocity[None], self._scene)
        context = None if context is None else context[None]
        state = SimulatorState(offset[None], velocity[None])
        shape = shape_of(state.offset, layout, self._scene)
        after, force = corrected_step(self._simulator, layout, state, known, context, shape)
        found = {'next_offset': after.offset[0], 'next_velocity': after.velocity[0]}
        return found if force is None else found | {'force': force[0]}

    def reconstruct(self, modes):
        """Soil particles float32 [N, D], m, of mode scores float32 [r, D] (inverse PCA)."""
        components, mean = (
            tf.constant(x, tf.float32) for x in (self._space.components, self._space.mean)
        )
        return {'particles': tf.linalg.matmul(components, modes) + mean}

    def write(self, kind: str, folder: str) -> dict:
        """Writes the functions in a format and calls to try them with, and compares what was
        written with its source; returns what the description says of it.

        Raises:
          ValueError: a scene that the format cannot hold, no converter, or a difference above its
            tolerance.
        """
        functions, samples = self._functions(kind), self._samples()
        load = _WRITERS[kind](functions, self._simulator.trainable_variables, folder)
        start = time.perf_counter()
        loaded = load()
        seconds = time.perf_counter() - start
        compared = self._compared(loaded, samples)
        arrays: dict[str, np.ndarray] = {}
        for calls in samples.values():
            named = [inputs | outputs for inputs, outputs in calls]
            arrays = {name: np.stack([row[name] for row in named]) for name in named[0]} | arrays
        files.write_npz(os.path.join(folder, 'sample.npz'), **arrays)
        signatures = {
            name: {
                'inputs': _rows(calls[0][0]),
                'outputs': _rows(functions[name].structured_outputs),
            }
            for name, calls in samples.items()
        }
        return {'signatures': signatures, 'load_s': seconds, 'compared': compared}

    def _functions(self, kind):
        """Name -> concrete function; those of a SavedModel are compiled by XLA."""
        if kind != 'savedmodel' and self._scene.rigid_motion == RigidMotion.PREDICTED:
            raise ValueError(
                'LiteRT and ONNX have no eigenvalue solver for the correction of a predicted rigid '
                'body; export a SavedModel, or a model whose rigid motion is given or driven'
            )
        n_node, n, dim = self._layout.n_node, self._layout.n_rigid, self._simulator.dim
        shapes: dict[str, tuple] = {'offset': (n_node, dim), 'velocity': (n_node, H - 1, dim)}
        if self._scene.rigid_motion.is_known:
            shapes |= {'rigid_offset': (n, dim), 'rigid_velocity': (n, dim)}
        if self._scene.context_names:
            shapes['context'] = (len(self._scene.context_names),)
        found = {'step': (self.step, shapes)}
        if self._space is not None:
            found['reconstruct'] = self.reconstruct, {'modes': (self._scene.n_modes, dim)}
        compiled = kind == 'savedmodel' or None
        return {
            name: tf.function(function, autograph=False, jit_compile=compiled)
            .get_concrete_function(**{k: tf.TensorSpec(s, name=k) for k, s in rows.items()})
            for name, (function, rows) in found.items()
        }  # fmt: skip

    def _samples(self):
        """Name -> calls, (inputs, outputs of the source), of frames of the run."""
        group, n = self._group, self._layout.n_rigid
        offset, velocity = group.position[0] - self._layout.origin, group.velocity[0]
        calls = []
        frames = np.linspace(H, len(offset) - 1, COMPARED_STEPS).astype(int)
        for k in frames:
            before = slice(k - H, k)
            state = initial_state(offset[None, before], velocity[None, before][:, 1:])
            inputs = {'offset': state.offset[0], 'velocity': state.velocity[0]}
            if self._scene.rigid_motion.is_known:
                inputs |= {'rigid_offset': offset[k, :n], 'rigid_velocity': velocity[k, :n]}
            if group.context is not None:
                inputs['context'] = group.context_at(k, 0)
            inputs = {name: np.asarray(x, np.float32) for name, x in inputs.items()}
            outputs = self.step(**{name: tf.constant(x) for name, x in inputs.items()})
            calls.append((inputs, {name: x.numpy() for name, x in outputs.items()}))
        if self._space is None:
            return {'step': calls}
        modes = group.position[0, frames, n:].astype(np.float32)
        decoded = [({'modes': m}, {'particles': self._space.decode(m)}) for m in modes]
        return {'step': calls, 'reconstruct': decoded}

    def _compared(self, loaded, samples):
        """Differences of loaded functions (name -> function of arrays) to the samples of their
        source, and times per call."""
        shares, milliseconds, particles = {}, {}, 0.0
        for function, calls in samples.items():
            seconds, pairs = [], {}
            for inputs, expected in calls:
                clock = time.perf_counter()
                found = {k: np.asarray(v) for k, v in loaded[function](**inputs).items()}
                seconds.append(time.perf_counter() - clock)
                parts = self._parts(found), self._parts(expected)
                for name in parts[1]:
                    each = [np.asarray(part[name], np.float64) for part in parts]
                    pairs.setdefault(name, []).append(each)
            milliseconds[function] = 1e3 * float(np.median(seconds[1:]))
            for name, values in pairs.items():
                one, other = (np.stack(column) for column in zip(*values))
                apart, size = float(np.abs(one - other).max()), float(np.abs(other).max())
                if name == 'particles_m':
                    particles = apart
                else:
                    shares[name] = apart / size if size > 0 else apart
        bad = {name: share for name, share in shares.items() if not share <= TOLERANCE}
        if not particles <= PARTICLES_TOLERANCE:
            bad['particles_m'] = particles
        if bad:
            raise ValueError(
                f'the exported model differs from its source by {bad}, more than {TOLERANCE:g} of '
                f'the largest motion or load or {PARTICLES_TOLERANCE:g} m; nothing was written'
            )
        return {
            'calls': len(calls),
            'relative_difference': shares,
            'tolerance': TOLERANCE,
            'particles_difference_m': particles,
            'particles_tolerance_m': PARTICLES_TOLERANCE,
            'ms_per_call': milliseconds,
        }

    def _parts(self, outputs):
        """What is compared: the last displacements of body and modes, force, particles."""
        if 'particles' in outputs:
            return {'particles_m': outputs['particles']}
        n, moved = self._layout.n_rigid, outputs['next_velocity'][:, -1]
        body = {'rigid': moved[:n]} if n else {}
        return {'modes': moved[n:]} | body | {k: outputs[k] for k in ('force',) if k in outputs}

    def describe(self) -> dict:
        """What a user of the exported model must know; JSON-able."""
        scene, config, layout = self._scene, self._simulator.config, self._layout
        chosen = f'the {layout.n_rigid} lowest of the first frame, in record order'
        if not config.rigid_particles:
            chosen = 'all, in record order'
        return {
            'scene': scene.to_json(),
            'nodes': f'{layout.n_rigid} rigid particles, then {scene.n_modes} modes',
            'rigid_particles': chosen,
            'seconds_per_frame': scene.dt,
            'frames_of_history': H,
            'origin': layout.origin.tolist(),
        }


def _rows(tensors):
    return {k: [list(t.shape), t.dtype.name, MEANING[k]] for k, t in tensors.items()}


def _write_saved_model(functions, variables, folder: str):
    holder = tf.Module(name='exported')  # Nothing but the weights goes into the file as an object.
    holder.weights = variables
    tf.saved_model.save(holder, folder, signatures=functions)

    def load():
        loaded = tf.saved_model.load(folder)

        def call(name, **inputs):
            return loaded.signatures[name](**{k: tf.constant(v) for k, v in inputs.items()})

        return {name: functools.partial(call, name) for name in functions}

    return load


def _write_tflite(functions, variables, folder: str):
    try:
        from ai_edge_litert.interpreter import Interpreter
    except ImportError as error:
        raise ValueError(_missing('ai-edge-litert')) from error
    holder = tf.Module(name='exported')
    holder.weights = variables
    paths = {name: os.path.join(folder, f'{name}.tflite') for name in functions}
    for name, concrete in functions.items():
        converter = tf.lite.TFLiteConverter.from_concrete_functions([concrete], holder)
        pathlib.Path(paths[name]).write_bytes(converter.convert())

    def load():
        return {
            name: Interpreter(model_path=path).get_signature_runner()
            for name, path in paths.items()
        }

    return load


def _write_onnx(functions, variables, folder: str):
    try:
        import onnxruntime
        import tf2onnx
    except ImportError as error:
        raise ValueError(_missing(error.name)) from error
    paths = {name: os.path.join(folder, f'{name}.onnx') for name in functions}
    for name, concrete in functions.items():
        # tf2onnx loses the inputs of a function of today's TensorFlow, but not of a frozen graph.
        frozen = convert_to_constants.convert_variables_to_constants_v2(concrete)
        ends = [[tensor.name for tensor in part] for part in (frozen.inputs, frozen.outputs)]
        proto, _ = tf2onnx.convert.from_graph_def(
            frozen.graph.as_graph_def(), input_names=ends[0], output_names=ends[1], opset=17
        )
        inputs = {end: end.split(':')[0] for end in ends[0]}
        _rename(proto.graph, inputs | dict(zip(ends[1], _outputs(concrete), strict=True)))
        pathlib.Path(paths[name]).write_bytes(proto.SerializeToString())

    def load():
        def caller(path, names):
            session = onnxruntime.InferenceSession(path, providers=['CPUExecutionProvider'])
            return lambda **inputs: dict(zip(names, session.run(names, inputs), strict=True))

        return {name: caller(paths[name], _outputs(c)) for name, c in functions.items()}

    return load


def _outputs(concrete):
    """Names of outputs in the order in which TensorFlow flattens a dict."""
    return sorted(concrete.structured_outputs)


def _rename(graph, names):
    for value in (*graph.input, *graph.output):
        value.name = names.get(value.name, value.name)
    for node in graph.node:
        for ends in (node.input, node.output):
            ends[:] = [names.get(name, name) for name in ends]


def _missing(package):
    return f'{package} is not installed; it comes with the extra: pip install -e .[deploy]'


_WRITERS = {'savedmodel': _write_saved_model, 'tflite': _write_tflite, 'onnx': _write_onnx}
