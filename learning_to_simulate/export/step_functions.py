"""The exported functions of a model in a subspace: `step` and `reconstruct`.

A step takes the state that the model has in Python, float32 offsets from `origin` and the last
displacements, and gives the next one. Positions themselves do not fit into float32.
"""

import os

import numpy as np
import tensorflow as tf

from learning_to_simulate import registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout import corrected_step
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace.learned_simulator import SimulatorState, initial_state
from learning_to_simulate.subspace.rigid_body import known_motion, shape_of
from pca_tools import subspace

COMPARED_STEPS = 8
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
    """The functions that are exported, for one graph of R rigid particles and r modes; ValueError
    for a model with a memory of the path. `space` is the `Subspace` for `reconstruct` (None: there
    is no such function), `group` a one-run `RunGroup` to compare on."""

    meaning = MEANING

    def __init__(self, simulator, layout, space, group):
        if simulator.config.reads_path:
            raise ValueError(
                'mode_order 0: an exported step has no memory of the path; use the stepper'
            )
        self._simulator, self._layout, self._space = simulator, layout, space
        self._scene, self._group = simulator.scene, group
        self.variables = simulator.trainable_variables

    @classmethod
    def of_dataset(cls, model_path: str, data_path: str):
        """Of a model folder and its dataset, which gives the subspace and a test run to compare
        on, of the largest body; raises as `registry.open_model`."""
        opened = registry.open_model(model_path, data_path, 'test')
        model, group = opened.model, max(opened.groups, key=lambda group: group.n_rigid)
        path, space = os.path.join(data_path, 'subspace.npz'), None
        if os.path.exists(path):
            space = model.fitting_subspace(subspace.Subspace.load(path))
        return cls(model.simulator, model.layout(group.n_rigid), space, group.select(0))

    def step(self, offset, velocity, rigid_offset=None, rigid_velocity=None, context=None):
        """The coming frame, a predicted body kept rigid; arguments and results as of `MEANING`."""
        layout, known = self._layout, None
        if rigid_offset is not None:
            known = known_motion(rigid_offset[None], rigid_velocity[None], self._scene)
        context = None if context is None else context[None]
        state, shape, n = SimulatorState(offset[None], velocity[None]), None, layout.n_rigid
        if self._scene.rigid_motion == RigidMotion.PREDICTED:
            shape = shape_of(state.offset[:, :n], layout.origin[:n])
        after, force = corrected_step(self._simulator, layout, state, known, context, shape)
        found = {'next_offset': after.offset[0], 'next_velocity': after.velocity[0]}
        return found if force is None else found | {'force': force[0]}

    def reconstruct(self, modes):
        """Soil particles float32 [N, D], m, of mode scores float32 [r, D] (inverse PCA)."""
        components, mean = (
            tf.constant(x, tf.float32) for x in (self._space.components, self._space.mean)
        )
        return {'particles': tf.linalg.matmul(components, modes) + mean}

    def functions(self, kind: str) -> dict:
        """Name -> function and its inputs by name; ValueError for a scene that the format cannot
        hold."""
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
        return {
            name: (function, {k: tf.TensorSpec(s, name=k) for k, s in rows.items()})
            for name, (function, rows) in found.items()
        }

    def samples(self) -> dict:
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

    def parts(self, outputs) -> dict:
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
