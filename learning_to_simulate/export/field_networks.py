"""The two networks of a swept field as exported functions: `load` and `soil`.

Both are functions of one frame of the tool's path (`tool.swept.Frame`: bins and scalars) and hold
no state. In Python a stepper computes the frames (`frame.modes.frame`); outside of it the C project
and the FMU hold the whole field, the state of its tool included.
"""

import numpy as np
import tensorflow as tf

from learning_to_simulate.swept_field import field as field_lib
from learning_to_simulate.swept_field.episodes import EpisodeReader
from pca_tools import dataset, splits

COMPARED_FRAMES = 8
# What the columns of `bins` are; m where nothing else is said.
CHANNELS = {
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
      meaning: of inputs and outputs, by name.
    """

    def __init__(self, model_path: str, data_path: str, n_particles: int | None = None):
        self._field = field = field_lib.load(model_path)
        n_rest = len(field.rest)
        n = n_rest if n_particles is None else n_particles
        if not 1 <= n <= n_rest:
            raise ValueError(f'n_particles is {n_particles}, must lie in [1, {n_rest}]')
        self.variables = field.network.trainable_variables
        metadata = dataset.read_metadata(data_path)
        reader = EpisodeReader(data_path, metadata, field)
        (episode,) = reader.read('test', limit=1)
        _, frames = field.frames(episode.ground, episode.pose, field.scene.dt)
        self._frames = frames.at(splits.spread_over(len(frames.scalars), COMPARED_FRAMES))
        rest = field.axes.points(field.rest[splits.spread_over(n_rest, n)])
        self._rest = (rest - episode.ground.origin).astype(np.float32)
        self.meaning = {
            'bins': 'a row for each of bin_offsets, columns of bin_channels',
            'scalars': 'see scalars',
            'rest': 'particles at the start: along the way from the first place of the tool, '
            'height over the level, distance from the middle plane; m',
            'loads': f'{field.config.members} members, columns of load_columns; take the mean',
            'displacement': 'of the particles from rest: along the way, up, across; m',
        }

    def load(self, bins, scalars):
        """`loads` [M, K] of each member: force along the way and up (N), torque in their plane
        (N m), of a wheel also the change of its height since the start (m)."""
        return {'loads': self._field.network.force(bins[None], scalars[None])[:, 0]}

    def soil(self, bins, scalars, rest):
        """`displacement` [P, 3] from rest, along the way, up, across (m): the members' mean. Tool
        and particles may still overlap by millimetres: the stepper pushes such particles out."""
        moved = self._field.network.displacement(bins[None], scalars[None], rest[None])
        return {'displacement': tf.reduce_mean(moved[:, 0], axis=0)}

    def functions(self, kind: str) -> dict:
        """Name -> function and its inputs by name; the same in each format."""
        grid, tool = self._field.grid, self._field.tool
        frame = {'bins': [len(grid.offsets), len(tool.channels)], 'scalars': [len(tool.scalars)]}
        shapes = {'load': frame, 'soil': frame | {'rest': list(self._rest.shape)}}
        return {
            name: (getattr(self, name), {k: tf.TensorSpec(s, name=k) for k, s in rows.items()})
            for name, rows in shapes.items()
        }

    def samples(self) -> dict:
        """Name -> calls, (inputs, outputs of the source), of frames of a recorded run."""
        loads = self._field.loads(self._frames).transpose(1, 0, 2)
        moved = self._field.displacement(self._frames, self._rest).mean(axis=0)
        frames = [{'bins': b, 'scalars': s} for b, s in zip(*self._frames)]
        return {
            'load': [(frame, {'loads': x}) for frame, x in zip(frames, loads)],
            'soil': [
                ({'rest': self._rest} | frame, {'displacement': x})
                for frame, x in zip(frames, moved)
            ],
        }

    def parts(self, outputs) -> dict:
        """What is compared: loads by their units, particles."""
        if 'displacement' in outputs:
            return {'particles_m': outputs['displacement']}
        loads = outputs['loads']
        parts = {'force': loads[:, :2], 'torque': loads[:, 2]}
        return parts | ({'height': loads[:, 3]} if self._field.tool.predicts_height else {})

    def describe(self) -> dict:
        """What a user of the exported networks must know; JSON-able."""
        field = self._field
        columns = ['force along the way, N', 'force up, N', 'torque in their plane, N m']
        return {
            'scene': field.scene.to_json(),
            'axis': field.axes.axis,
            'sign': field.axes.sign,
            'up': field.axes.up,
            'middle': field.axes.middle,
            'bin_offsets': [round(float(x), 9) for x in field.grid.offsets],
            'bin_channels': {name: CHANNELS[name] for name in field.tool.channels},
            'scalars': list(field.tool.scalars),
            'ranges': field.ranges,
            'calibration': field.calibration,
            'members': field.config.members,
            'load_columns': columns + ['change of height, m'] * field.tool.predicts_height,
            'left_out': 'the state of the path (bins and scalars of the next pose) and pushing '
            'particles out of the tool; the C project and the FMU have both',
        }
