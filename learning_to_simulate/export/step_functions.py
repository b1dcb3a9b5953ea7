"""The exported functions of a simulator in a subspace: step and reconstruct."""

import os
import time

import numpy as np
import tensorflow as tf

from learning_to_simulate import loads, registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import rigid_body
from learning_to_simulate.subspace.learned_simulator import SimulatorState, initial_state
from learning_to_simulate.subspace.rigid_body import KnownMotion, known_motion
from pca_tools import subspace

# Largest difference of one step to the source model, as a share of the largest motion or force of
# the compared frames. Measured 4e-7 (excavation) and 2e-6 (wheel): float32 sums in another order.
TOLERANCE = 1e-4
# Metres; float32 positions of a metre resolve 1e-7.
RECONSTRUCT_TOLERANCE = 2e-6
COMPARED_STEPS = 8
NAMES = {'tflite': 'LiteRT', 'onnx': 'ONNX'}


class StepFunctions:
    """The functions that are exported, for one graph of R rigid particles and r modes.

    Args:
      simulator: the model.
      layout: its graph.
      space: `Subspace` for `reconstruct`, or None: then there is no such function.
      group: one-run `RunGroup` to compare on.
    """

    def __init__(self, simulator, layout, space, group=None):
        if simulator.config.path_inputs:
            raise ValueError(
                'path_inputs: an exported step has no memory of the path; use the stepper of Python'
            )
        self.simulator, self.layout, self.space = simulator, layout, space
        self.variables = simulator.trainable_variables
        self._group = group

    @classmethod
    def of_dataset(cls, model_path: str, data_path: str, n_rigid: int | None = None):
        """Of a model folder, compared on the first test run of its dataset.

        Args:
          model_path, data_path: where they are; the dataset also gives the subspace.
          n_rigid: R; None for the largest of the test runs.

        Raises:
          FileNotFoundError, ValueError: as `registry.open_model`; no test run has such a body.
        """
        opened = registry.open_model(model_path, data_path, 'test')
        model, by_size = opened.model, {group.n_rigid: group for group in opened.groups}
        n_rigid = max(by_size) if n_rigid is None else n_rigid
        if n_rigid not in by_size:
            raise ValueError(
                f'{data_path}: no test run has {n_rigid} rigid nodes, there are {sorted(by_size)}'
            )
        path, space = os.path.join(data_path, 'subspace.npz'), None
        if os.path.exists(path):
            space = model.fitting_subspace(subspace.Subspace.load(path))
        return cls(model.simulator, model.layout(n_rigid), space, by_size[n_rigid].select(0))

    def step(self, position_history, next_rigid_position=None, context=None):
        """One frame from recorded or predicted frames.

        Args:
          position_history: float64 [H, V, D], m, oldest first; R rigid particles, then r modes.
          next_rigid_position: float64 [R, D], m, the body in the coming frame, where its motion is
            given; where only the height is predicted, any height.
          context: float32 [C].

        Returns:
          dict of `next_position` float64 [V, D], its parts `modes` [r, D] and `rigid_position`
          [R, D], `force` float32 [D], N, and `torque` [D], N m, where it is predicted.
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
        after, load = self.simulator.step(state, known, context, layout)
        # The displacement is added in float64: positions of modes do not fit into float32.
        position = last + tf.cast(after.velocity[0, :, -1], tf.float64)
        if scene.rigid_motion == RigidMotion.PREDICTED:
            shape = last[:n] - tf.reduce_mean(last[:n], axis=0, keepdims=True)
            body = rigid_body.rigid_correction(shape[None], position[None, :n])[0]
            position = tf.concat([body, position[n:]], axis=0)
        outputs = {'next_position': position, 'modes': position[n:]}
        if n:
            outputs['rigid_position'] = position[:n]
        return outputs | self.loads_of(load)

    def state_step(self, offset, velocity, rigid_offset=None, rigid_velocity=None, context=None):
        """One frame of the float32 state that LiteRT and ONNX carry.

        Args:
          offset: float32 [V, D], position minus origin, m.
          velocity: float32 [V, H - 1, D], the last displacements, newest last, m/frame.
          rigid_offset, rigid_velocity: float32 [R, D] of the coming frame, as `KnownMotion`.
          context: float32 [C].

        Returns:
          dict of the next `offset` and `velocity`, `force` [D], N, and `torque` [D], N m, where it
          is predicted.
        """
        known = None
        if rigid_offset is not None:
            known = KnownMotion(rigid_offset[None], rigid_velocity[None])
        context = None if context is None else context[None]
        state = SimulatorState(offset[None], velocity[None])
        after, load = self.simulator.step(state, known, context, self.layout)
        outputs = {'offset': after.offset[0], 'velocity': after.velocity[0]}
        return outputs | self.loads_of(load)

    def loads_of(self, load) -> dict:
        """Name -> [D] of what there is of the loads [1, F] of a step."""
        parts = zip(loads.NAMES, loads.split(load, self.simulator.statistics), strict=True)
        return {name: part[0] for name, part in parts if part is not None}

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

    def compare(self, loaded, kind: str, folder: str) -> dict:
        """Differences to the source over steps from recorded histories, and times per call.

        Args:
          loaded: name -> function of arrays, as read again.
          kind: of the format.
          folder: nothing is written into it here.

        Raises:
          ValueError: a difference above the tolerance, or outputs that are not finite.
        """
        group, space, n = self._group, self.space, self.layout.n_rigid
        n_frame = group.position.shape[1]
        moved, expected, seconds = [], [], []
        found = {}  # name of a load -> pairs of exported and source
        for k in np.linspace(H, n_frame - 1, COMPARED_STEPS).astype(int):
            inputs = self.inputs(kind, group, k)
            start = time.perf_counter()
            outputs = {name: np.asarray(value) for name, value in loaded['step'](**inputs).items()}
            seconds.append(time.perf_counter() - start)
            before = group.position[0, k - 1]
            if kind == 'savedmodel':
                moved.append(outputs['next_position'] - before)
            else:
                moved.append(outputs[self.output_name(kind, 'velocity')][:, -1])
            velocity, of_source = self.source_step(group, k)
            expected.append(velocity)
            for name, load in of_source.items():
                pair = outputs[self.output_name(kind, name)], load
                found.setdefault(name, []).append(pair)
        differences = {'modes': _difference(moved, expected, slice(n, None))}
        if n:
            differences['rigid'] = _difference(moved, expected, slice(n))
        for name, pairs in found.items():
            differences[name] = _difference(*zip(*pairs), slice(None))  # type: ignore[call-arg]
        values = {
            'steps': COMPARED_STEPS,
            'relative_difference': differences,
            'tolerance': TOLERANCE,
            'first_call_s': seconds[0],
            'ms_per_step_median': 1e3 * float(np.median(seconds[1:])),
        }
        bad = {name: d for name, d in differences.items() if not d <= TOLERANCE}
        if 'reconstruct' in loaded:
            modes = group.position[0, :, n:]

            def reconstruct(scores):
                return np.asarray(loaded['reconstruct'](modes=scores)['particles'])

            particles = [reconstruct(modes[k]) for k in (0, n_frame - 1)]
            apart = max(
                float(np.abs(p - space.decode(modes[k])).max())
                for p, k in zip(particles, (0, n_frame - 1))
            )
            values |= {
                'particles_difference_m': apart,
                'particles_tolerance_m': RECONSTRUCT_TOLERANCE,
            }
            start = time.perf_counter()
            for frame in modes[:COMPARED_STEPS]:
                reconstruct(frame)
            values['ms_per_reconstruction'] = 1e3 * (time.perf_counter() - start) / COMPARED_STEPS
            if not apart <= RECONSTRUCT_TOLERANCE:
                bad['particles_m'] = apart
        if bad:
            raise ValueError(
                f'the exported model differs from its source by {bad}, more than {TOLERANCE:g} of '
                f'the largest motion or {RECONSTRUCT_TOLERANCE:g} m; nothing was written'
            )
        return values

    @staticmethod
    def output_name(kind: str, name: str) -> str:
        """What an output is called: in ONNX none has the name of an input."""
        return f'next_{name}' if kind == 'onnx' else name

    def concrete(self, kind: str) -> dict:
        """Name -> concrete function of a format; those of a SavedModel are compiled by XLA.

        Raises:
          ValueError: a scene that the format cannot hold.
        """
        is_saved_model = kind == 'savedmodel'
        if not is_saved_model and self.simulator.scene.rigid_motion == RigidMotion.PREDICTED:
            raise ValueError(
                f'{NAMES[kind]} has no eigenvalue solver for the correction of a predicted rigid '
                'body; export a SavedModel, or a model whose rigid motion is given or driven'
            )

        def step(**inputs):
            found = self.step(**inputs) if is_saved_model else self.state_step(**inputs)
            return {self.output_name(kind, name): value for name, value in found.items()}

        compiled = is_saved_model or None
        function = tf.function(step, jit_compile=compiled)
        functions = {'step': function.get_concrete_function(**self.step_signature(kind))}
        if is_saved_model and self.space is not None:
            shape = [self.simulator.scene.n_modes, self.simulator.dim]
            spec = tf.TensorSpec(shape, tf.float64, name='modes')
            function = tf.function(self.reconstruct, jit_compile=compiled)
            functions['reconstruct'] = function.get_concrete_function(spec)
        return functions

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
        """What the source model says: displacements [V, D], and name -> [D] of the loads."""
        state, known = self._recorded(group, frame)
        context = group.context_at(frame)
        context = None if context is None else tf.constant(context, tf.float32)
        after, load = self.simulator.step(state, known, context, self.layout)
        velocity = after.velocity[0, :, -1].numpy().astype(np.float64)
        if self.simulator.scene.rigid_motion == RigidMotion.PREDICTED:
            n, last = self.layout.n_rigid, group.position[:, frame - 1]
            shape = last[:, :n] - last[:, :n].mean(axis=1, keepdims=True)
            placed = rigid_body.rigid_correction(shape, last[:, :n] + velocity[None, :n])
            velocity[:n] = placed[0].numpy() - last[0, :n]
        return velocity, {name: part.numpy() for name, part in self.loads_of(load).items()}

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
            'units': 'positions m, velocities m/frame, force N'
            + (', torque N m about the point of recorded poses' if config.predict_torque else ''),
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


def _difference(values, expected, part):
    """Largest difference over the largest magnitude; 0 / 0 counts as 0."""
    a, b = (np.stack(x).astype(np.float64)[:, part] for x in (values, expected))
    apart, size = np.abs(a - b).max(), np.abs(b).max()
    return float(apart / size) if size > 0 else float(apart)
