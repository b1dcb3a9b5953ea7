"""The two networks of a swept field as exported functions: `load` and `soil`.

Both are functions of one frame of the tool's path (`tool.swept.Frame`: bins and scalars) and hold
no state. In Python a stepper computes the frames (`frame.modes.frame`); outside of it the C project
and the FMU hold the whole field, the state of its tool included.
"""

import os
import time

import numpy as np
import tensorflow as tf

from learning_to_simulate.swept_field import field as field_lib
from learning_to_simulate.swept_field.episodes import EpisodeReader
from pca_tools import dataset, files, splits

SAMPLE_FILE = 'sample.npz'
# Largest differences to the source: of the loads as a share of the largest, of the particles in m.
# Measured 2e-6 and 2e-8 m: float32 sums in another order.
TOLERANCE = 1e-4
PARTICLES_TOLERANCE = 2e-6
COMPARED_FRAMES = 8
# What the columns of `bins` are; m where nothing else is said.
MEANING = {
    'cut': 'depth of the cut or rut',
    'surface': 'height of the untouched surface over the level',
    'since': 'distance travelled since the tool was last there',
    'influence': 'of all that was cut or borne on, 0 to 1',
    'disturbed': 'depth to which soil may have moved',
    'area_before': 'swept area (m2) when the bin was first cut',
    'first_cut': 'depth of the rut in the first frame',
    'slid': 'slip while the bin bore the rim',
    'shear': 'the same with sign',
    'peak': 'largest load that the bin bore (N)',
}


class FieldNetworks:
    """The exported functions of a field, all members at work.

    Args:
      model_path, data_path: a swept field and its dataset, whose first test run is compared.
      n_particles: P of `soil`; None for all of the bed at rest.

    Raises:
      FileNotFoundError, ValueError: no model or dataset there; more particles than there are.

    Attributes:
      variables: the weights.
    """

    def __init__(self, model_path: str, data_path: str, n_particles: int | None = None):
        self.field = field = field_lib.load(model_path)
        n_rest = len(field.rest)
        self.n_particles = n_rest if n_particles is None else n_particles
        if not 1 <= self.n_particles <= n_rest:
            raise ValueError(f'n_particles is {n_particles}, must lie in [1, {n_rest}]')
        self.variables = field.network.trainable_variables
        metadata = dataset.read_metadata(data_path)
        reader = EpisodeReader(data_path, metadata, field)
        (episode,) = reader.read('test', limit=1)
        _, frames = field.frames(episode.ground, episode.pose, field.scene.dt)
        self._frames = frames.at(splits.spread_over(len(frames.scalars), COMPARED_FRAMES))
        rest = field.axes.points(field.rest[splits.spread_over(n_rest, self.n_particles)])
        self._rest = (rest - episode.ground.origin).astype(np.float32)
        self._concrete: dict[str, dict] = {}

    def load(self, bins, scalars):
        """`loads` [M, K] of each member: force along the way and up (N), torque in their plane
        (N m), of a wheel also the change of its height since the start (m)."""
        return {'loads': self.field.network.force(bins[None], scalars[None])[:, 0]}

    def soil(self, bins, scalars, rest):
        """`displacement` [P, 3] from rest, along the way, up, across (m): the members' mean. Tool
        and particles may still overlap by millimetres: the stepper pushes such particles out."""
        moved = self.field.network.displacement(bins[None], scalars[None], rest[None])
        return {'displacement': tf.reduce_mean(moved[:, 0], axis=0)}

    def signatures(self) -> dict[str, dict[str, tf.TensorSpec]]:
        """Name of a function -> its inputs by name."""
        grid, tool = self.field.grid, self.field.tool
        frame = {'bins': [len(grid.offsets), len(tool.channels)], 'scalars': [len(tool.scalars)]}
        shapes = {'load': frame, 'soil': frame | {'rest': [self.n_particles, 3]}}
        return {
            function: {name: tf.TensorSpec(s, tf.float32, name=name) for name, s in rows.items()}
            for function, rows in shapes.items()
        }

    def concrete(self, kind: str) -> dict:
        """Name -> concrete function of a format; those of a SavedModel are compiled by XLA."""
        compiled = kind == 'savedmodel' or None
        if kind not in self._concrete:
            self._concrete[kind] = {
                name: tf.function(
                    getattr(self, name), autograph=False, jit_compile=compiled
                ).get_concrete_function(**specs)
                for name, specs in self.signatures().items()
            }
        return self._concrete[kind]

    def compare(self, loaded, kind: str, folder: str) -> dict:
        """Differences to the source in frames of a recorded run, which are left in `SAMPLE_FILE`:
        inputs and outputs to check another program with.

        Args:
          loaded: name -> function of arrays, as read again.
          kind: of the format; here all are compared alike.
          folder: to write the sample into.

        Raises:
          ValueError: a difference above its tolerance.
        """
        frames, rest = self._frames, self._rest
        loads = self.field.loads(frames).transpose(1, 0, 2)
        moved = self.field.displacement(frames, rest).mean(axis=0)
        seconds, found = [], []
        for bins, scalars in zip(frames.bins, frames.scalars, strict=True):
            clock = time.perf_counter()
            found.append(np.asarray(loaded['load'](bins=bins, scalars=scalars)['loads']))
            seconds.append(time.perf_counter() - clock)
        clock = time.perf_counter()
        soil = [
            np.asarray(loaded['soil'](bins=b, scalars=s, rest=rest)['displacement'])
            for b, s in zip(frames.bins, frames.scalars)
        ]
        soil_seconds = (time.perf_counter() - clock) / len(soil)
        apart = float(np.abs(np.stack(soil) - moved).max())
        # Columns have units of their own: force and torque, and a wheel's height.
        size = np.maximum(np.abs(loads).max(axis=(0, 1)), 1e-12)
        difference = float((np.abs(np.stack(found) - loads).max(axis=(0, 1)) / size).max())
        if not (difference <= TOLERANCE and apart <= PARTICLES_TOLERANCE):
            raise ValueError(
                f'the exported networks differ from their source by {difference:.2g} of the '
                f'largest load (allowed {TOLERANCE:g}) or {apart:.2g} m of the particles (allowed '
                f'{PARTICLES_TOLERANCE:g} m); nothing was written'
            )
        files.write_npz(
            os.path.join(folder, SAMPLE_FILE),
            bins=frames.bins, scalars=frames.scalars, rest=rest, loads=loads, displacement=moved,
        )  # fmt: skip
        return {
            'steps': len(found),
            'relative_difference': {'loads': difference},
            'tolerance': TOLERANCE,
            'first_call_s': seconds[0],
            'ms_per_step_median': 1e3 * float(np.median(seconds[1:])),
            'particles_difference_m': apart,
            'particles_tolerance_m': PARTICLES_TOLERANCE,
            'ms_per_particles': 1e3 * soil_seconds,
        }

    def describe(self, kind: str) -> dict:
        """What a user of the exported networks must know; JSON-able."""
        field = self.field
        meaning = {
            'bins': 'a row for each of bin_offsets, columns of bin_channels',
            'scalars': 'see scalars',
            'rest': 'particles at the start: along the way from the first place of the tool, '
            'height over the level, distance from the middle plane; m',
            'loads': f'{field.config.members} members, columns of load_columns; take the mean',
            'displacement': 'of the particles from rest: along the way, up, across; m',
        }
        columns = ['force along the way, N', 'force up, N', 'torque in their plane, N m']
        return {
            'format': kind,
            'signatures': {
                name: {
                    'inputs': _rows(inputs, meaning),
                    'outputs': _rows(self.concrete(kind)[name].structured_outputs, meaning),
                }
                for name, inputs in self.signatures().items()
            },
            'scene': field.scene.to_json(),
            'axis': field.axes.axis,
            'sign': field.axes.sign,
            'up': field.axes.up,
            'middle': field.axes.middle,
            'bin_offsets': [round(float(x), 9) for x in field.grid.offsets],
            'bin_channels': {name: MEANING[name] for name in field.tool.channels},
            'scalars': list(field.tool.scalars),
            'ranges': field.ranges,
            'calibration': field.calibration,
            'members': field.config.members,
            'load_columns': columns + ['change of height, m'] * field.tool.predicts_height,
            'left_out': 'the state of the path (bins and scalars of the next pose) and pushing '
            'particles out of the tool; the C project and the FMU have both',
        }


def _rows(tensors, meaning):
    return {k: [list(t.shape), t.dtype.name, meaning[k]] for k, t in tensors.items()}
