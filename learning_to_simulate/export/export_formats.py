"""The exported functions of a simulator, and the file formats they are written in."""

import os
import warnings

import numpy as np
import tensorflow as tf
from tensorflow.python.framework import convert_to_constants

from learning_to_simulate import rigid_body
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.learned_simulator import (
    SimulatorState,
    initial_state,
)
from learning_to_simulate.rigid_body import KnownMotion, known_motion
from learning_to_simulate.scene import RigidMotion
from pca_tools import files

TFLITE_FILE = 'step.tflite'


class StepFunctions:
    """The functions that are exported, for one graph of R rigid particles and r modes.

    Args:
      simulator: the model.
      layout: its graph.
      space: `Subspace` for `reconstruct`, or None: then there is no such function.
    """

    def __init__(self, simulator, layout, space):
        if simulator.config.path_inputs:
            raise ValueError(
                'path_inputs: an exported step has no memory of the path; use the stepper of Python'
            )
        self.simulator, self.layout, self.space = simulator, layout, space

    def step(self, position_history, next_rigid_position=None, context=None):
        """One frame from recorded or predicted frames.

        Args:
          position_history: float64 [H, V, D], m, oldest first; R rigid particles, then r modes.
          next_rigid_position: float64 [R, D], m, the body in the coming frame, where its motion is
            given; where only the height is predicted, any height.
          context: float32 [C].

        Returns:
          dict of `next_position` float64 [V, D], its parts `modes` [r, D] and `rigid_position`
          [R, D], and `force` float32 [D], N.
        """
        layout, scene = self.layout, self.simulator.scene
        n, last = layout.n_rigid, position_history[-1]
        offset = (position_history - layout.origin)[None]
        state = initial_state(offset, offset[:, 1:] - offset[:, :-1])
        known = None
        if scene.rigid_motion.is_known:
            body = next_rigid_position - layout.origin[:n], next_rigid_position - last[:n]
            known = known_motion(*body, scene)
            known = KnownMotion(*(tf.cast(x, tf.float32)[None] for x in known[:2]))
        context = None if context is None else context[None]
        after, force = self.simulator.step(state, known, context, layout)
        # The displacement is added in float64: positions of modes do not fit into float32.
        position = last + tf.cast(after.velocity[0, :, -1], tf.float64)
        if scene.rigid_motion == RigidMotion.PREDICTED:
            shape = last[:n] - tf.reduce_mean(last[:n], axis=0, keepdims=True)
            body = rigid_body.rigid_correction(shape[None], position[None, :n])[0]
            position = tf.concat([body, position[n:]], axis=0)
        outputs = {'next_position': position, 'modes': position[n:]}
        if n:
            outputs['rigid_position'] = position[:n]
        return outputs | ({} if force is None else {'force': force[0]})

    def state_step(self, offset, velocity, rigid_offset=None, rigid_velocity=None, context=None):
        """One frame of the float32 state that LiteRT and ONNX carry.

        Args:
          offset: float32 [V, D], position minus origin, m.
          velocity: float32 [V, H - 1, D], the last displacements, newest last, m/frame.
          rigid_offset, rigid_velocity: float32 [R, D] of the coming frame, as `KnownMotion`.
          context: float32 [C].

        Returns:
          dict of the next `offset` and `velocity`, and `force` [D], N.
        """
        known = None
        if rigid_offset is not None:
            known = KnownMotion(rigid_offset[None], rigid_velocity[None])
        context = None if context is None else context[None]
        state = SimulatorState(offset[None], velocity[None])
        after, force = self.simulator.step(state, known, context, self.layout)
        outputs = {'offset': after.offset[0], 'velocity': after.velocity[0]}
        return outputs | ({} if force is None else {'force': force[0]})

    def reconstruct(self, modes):
        """Soil particles float32 [N, D], m, of mode scores float64 [r, D] (inverse PCA)."""
        space = self.space
        weights = tf.constant(space.components, tf.float32)
        return {
            'particles': tf.linalg.matmul(weights, tf.cast(modes, tf.float32))
            + space.mean.astype(np.float32)
        }

    def step_signature(self, kind: str) -> dict[str, tf.TensorSpec]:
        """Inputs of the exported step by name."""
        scene, layout = self.simulator.scene, self.layout
        dim, n = self.simulator.dim, layout.n_rigid
        shapes: dict[str, tuple[tuple[int, ...], tf.DType]]
        if kind == 'savedmodel':
            shapes = {'position_history': ((H, layout.n_node, dim), tf.float64)}
            if scene.rigid_motion.is_known:
                shapes['next_rigid_position'] = ((n, dim), tf.float64)
        else:
            shapes = {
                'offset': ((layout.n_node, dim), tf.float32),
                'velocity': ((layout.n_node, H - 1, dim), tf.float32),
            }
            if scene.rigid_motion.is_known:
                shapes |= {f'rigid_{x}': ((n, dim), tf.float32) for x in ('offset', 'velocity')}
        if scene.context_names:
            shapes['context'] = ((len(scene.context_names),), tf.float32)
        return {name: tf.TensorSpec(*s, name=name) for name, s in shapes.items()}

    def concrete_step(self, kind: str, compiled: bool):
        """The step as a concrete function; `compiled` by XLA."""
        python = self.step if kind == 'savedmodel' else self.state_step
        function = tf.function(python, jit_compile=compiled or None)
        return function.get_concrete_function(**self.step_signature(kind))

    def inputs(self, kind: str, group, frame: int) -> dict[str, np.ndarray]:
        """Inputs of the exported step that predicts a frame of a recorded run (`RunGroup`)."""
        layout, scene = self.layout, self.simulator.scene
        n, position = layout.n_rigid, group.position[0]
        values = {}
        if kind == 'savedmodel':
            values['position_history'] = position[frame - H : frame]
            if scene.rigid_motion.is_known:
                values['next_rigid_position'] = position[frame, :n]
        else:
            state, known = self._recorded(group, frame)
            values |= {'offset': state.offset[0].numpy(), 'velocity': state.velocity[0].numpy()}
            if known is not None:
                values['rigid_offset'], values['rigid_velocity'] = (x[0].numpy() for x in known[:2])
        if group.context is not None:
            values['context'] = group.context_at(frame, 0).astype(np.float32)
        return values

    def source_step(self, group, frame: int):
        """What the source model says: displacements [V, D] and force [D] or None."""
        state, known = self._recorded(group, frame)
        context = group.context_at(frame)
        context = None if context is None else tf.constant(context, tf.float32)
        after, force = self.simulator.step(state, known, context, self.layout)
        velocity = after.velocity[0, :, -1].numpy().astype(np.float64)
        if self.simulator.scene.rigid_motion == RigidMotion.PREDICTED:
            n, last = self.layout.n_rigid, group.position[:, frame - 1]
            shape = last[:, :n] - last[:, :n].mean(axis=1, keepdims=True)
            placed = rigid_body.rigid_correction(shape, last[:, :n] + velocity[None, :n])
            velocity[:n] = placed[0].numpy() - last[0, :n]
        return velocity, None if force is None else force[0].numpy()

    def _recorded(self, group, frame):
        """State and known motion, float32, before a recorded frame."""
        n, scene = self.layout.n_rigid, self.simulator.scene
        offset, velocity = group.position - self.layout.origin, group.velocity
        h = slice(frame - H, frame)
        state = initial_state(offset[:, h], velocity[:, h][:, 1:])
        known = known_motion(offset[:, frame, :n], velocity[:, frame, :n], scene)
        if known is not None:
            known = KnownMotion(*(tf.cast(x, tf.float32) for x in known[:2]))
        return state, known

    def describe(self, kind: str) -> dict:
        """What a user of the exported model must know; JSON-able."""
        scene, config, layout = self.simulator.scene, self.simulator.config, self.layout
        signature = {k: [list(s.shape), s.dtype.name] for k, s in self.step_signature(kind).items()}
        signatures = {'step': signature}
        if self.space is not None:
            modes = [[scene.n_modes, self.simulator.dim], 'float64']
            if kind == 'savedmodel':
                signatures['reconstruct'] = {'modes': modes}
        values = {
            'format': kind,
            'signatures': signatures,
            'scene': scene.to_json(),
            'nodes': f'{layout.n_rigid} rigid particles, then {scene.n_modes} modes',
            'rigid_particles': f'every {config.rigid_stride}. in record order'
            if config.rigid_stride > 1 or not config.rigid_particles
            else f'the {layout.n_rigid} lowest of the first frame, in record order',
            'units': 'positions m, velocities m/frame, force N',
            'seconds_per_frame': scene.dt,
            'frames_of_history': H,
        }  # fmt: skip
        if kind != 'savedmodel':
            values['origin'] = layout.origin.tolist()
            values['state'] = (
                'offset = position - origin; velocity [V, H - 1, D] = last displacements, newest '
                'last; rigid_offset and rigid_velocity of the coming frame'
                + (', with the mean height over the particles taken out'
                   if scene.rigid_motion == RigidMotion.DRIVEN else '')
                + ('; outputs are named next_*' if kind == 'onnx' else '')
            )  # fmt: skip
        return values


def _write_saved_model(functions: StepFunctions, folder: str):
    """SavedModel; returns a function that loads it: (step, reconstruct or None)."""
    signatures = {'step': functions.concrete_step('savedmodel', compiled=True)}
    if functions.space is not None:
        spec = tf.TensorSpec(
            [functions.simulator.scene.n_modes, functions.simulator.dim], tf.float64, name='modes'
        )
        signatures['reconstruct'] = tf.function(
            functions.reconstruct, jit_compile=True
        ).get_concrete_function(spec)
    holder = tf.Module(name='exported')  # Nothing but the weights goes into the file as an object.
    holder.weights = functions.simulator.trainable_variables
    tf.saved_model.save(holder, folder, signatures=signatures)

    def load():
        loaded = tf.saved_model.load(folder)

        def step(**inputs):
            return loaded.signatures['step'](**{k: tf.constant(v) for k, v in inputs.items()})

        if 'reconstruct' not in loaded.signatures:
            return step, None
        return step, lambda modes: loaded.signatures['reconstruct'](
            modes=tf.constant(modes, tf.float64)
        )['particles']

    return load


def _write_tflite(functions: StepFunctions, folder: str):
    """LiteRT flatbuffer."""
    _refuse_correction(functions, 'LiteRT')
    concrete = functions.concrete_step('tflite', compiled=False)
    converter = tf.lite.TFLiteConverter.from_concrete_functions([concrete], functions.simulator)
    content = converter.convert()
    path = os.path.join(folder, TFLITE_FILE)
    _write_bytes(path, content)

    def load():
        interpreter = litert_interpreter()(model_path=path)
        runner = interpreter.get_signature_runner()
        return lambda **inputs: runner(**inputs), None

    return load


def litert_interpreter():
    try:
        from ai_edge_litert.interpreter import Interpreter
    except ImportError:
        interpreter = getattr(tf.lite, 'Interpreter', None)  # Leaves TensorFlow one day.
        if interpreter is None:
            raise ValueError(_missing('ai-edge-litert')) from None
        warnings.filterwarnings('ignore', message='.*tf.lite.Interpreter is deprecated.*')
        return interpreter
    return Interpreter


def _write_onnx(functions: StepFunctions, folder: str):
    """ONNX graph `step.onnx`."""
    _refuse_correction(functions, 'ONNX')
    try:
        import onnxruntime
        import tf2onnx
    except ImportError as error:
        raise ValueError(_missing(error.name)) from error
    path = os.path.join(folder, 'step.onnx')
    concrete = functions.concrete_step('onnx', compiled=False)
    # tf2onnx loses the inputs of a function of today's TensorFlow, but not those of a frozen graph.
    frozen = convert_to_constants.convert_variables_to_constants_v2(concrete)
    ends = [[tensor.name for tensor in part] for part in (frozen.inputs, frozen.outputs)]
    proto, _ = tf2onnx.convert.from_graph_def(
        frozen.graph.as_graph_def(), input_names=ends[0], output_names=ends[1], opset=17
    )
    outputs = sorted(concrete.structured_outputs)  # The order in which TensorFlow flattens a dict.
    names = [f'next_{name}' for name in outputs]
    _rename(
        proto.graph,
        {name: name.split(':')[0] for name in ends[0]} | dict(zip(ends[1], names, strict=True)),
    )
    _write_bytes(path, proto.SerializeToString())

    def load():
        session = onnxruntime.InferenceSession(path, providers=['CPUExecutionProvider'])

        def step(**inputs):
            return dict(zip(outputs, session.run(names, inputs), strict=True))

        return step, None

    return load


def _rename(graph, names):
    """Gives the tensors of an ONNX graph other names."""
    for value in (*graph.input, *graph.output):
        value.name = names.get(value.name, value.name)
    for node in graph.node:
        for ends in (node.input, node.output):
            ends[:] = [names.get(name, name) for name in ends]


def _write_bytes(path, content):
    def write(name):
        with open(name, 'wb') as file:
            file.write(content)

    files.write_atomically(path, write)


def _missing(package):
    return f'{package} is not installed; it comes with the extra: pip install -e .[deploy]'


def _refuse_correction(functions, name):
    if functions.simulator.scene.rigid_motion == RigidMotion.PREDICTED:
        raise ValueError(
            f'{name} has no eigenvalue solver for the correction of a predicted rigid body; '
            'export a SavedModel, or a model whose rigid motion is given or driven'
        )


WRITERS = {'savedmodel': _write_saved_model, 'tflite': _write_tflite, 'onnx': _write_onnx}
