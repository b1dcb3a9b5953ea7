"""The exported functions of a model in a subspace: `step` and `reconstruct`.

A step takes the state that the model has in Python, float32 offsets from `origin` and the last
displacements, and gives the next one. Positions themselves do not fit into float32.
"""

import os
import time

import numpy as np
import tensorflow as tf

from learning_to_simulate import registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.export import export_formats
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

    def write(self, kind: str, folder: str) -> dict:
        """Writes the functions in a format and calls to try them with, and compares what was
        written with its source; returns what the description says of it.

        Raises:
          ValueError: a scene that the format cannot hold, no converter, or a difference above its
            tolerance.
        """
        functions, samples = self._functions(kind), self._samples()
        concrete = export_formats.concrete(functions, kind)
        variables = self._simulator.trainable_variables
        load = export_formats.WRITERS[kind](concrete, variables, folder)
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
            name: {'inputs': _rows(functions[name][1]), 'outputs': _rows(found.structured_outputs)}
            for name, found in concrete.items()
        }
        return {'signatures': signatures, 'load_s': seconds, 'compared': compared}

    def _functions(self, kind):
        """Name -> function and its inputs by name."""
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
