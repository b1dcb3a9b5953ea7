"""The exported functions of a swept field: start, step, particles.

They are those of `swept_field.live.LiveField` without its memory: what a field knows of its tool
goes in and out as two float32 tensors. A graph cannot raise: what `LiveField` refuses leaves the
state as it is, and `status` says so.
"""

import numpy as np
import tensorflow as tf

from learning_to_simulate.export import field_description, field_state
from learning_to_simulate.export.field_blade import BladeForm
from learning_to_simulate.export.field_state import LARGEST, STATUS
from learning_to_simulate.export.field_wheel import WheelForm
from learning_to_simulate.live.poses import UNIT_TOLERANCE
from learning_to_simulate.methods import tensors
from learning_to_simulate.methods.swept_field import quality

# By the name of a tool.
FORMS = {'blade': BladeForm, 'wheel': WheelForm}


class FieldFunctions:
    """The functions of one field with shapes that are fixed.

    Args:
      field: `SweptField`.
      members: networks that answer; None: all.
      n_particles: P of `particles`; None: of the bed at rest.

    Raises:
      ValueError: so many members or particles there are not.

    Attributes:
      field, members, n_particles: as given.
      form: what the functions know of the tool, see `field_state.Form`.
      variables: the weights.
    """

    def __init__(self, field, members: int | None = None, n_particles: int | None = None):
        members = field.config.members if members is None else members
        n_particles = len(field.rest) if n_particles is None else n_particles
        for name, value, most in (
            ('members', members, field.config.members),
            ('n_particles', n_particles, len(field.rest)),
        ):
            if not 1 <= value <= most:
                raise ValueError(f'{name} is {value}, must lie in [1, {most}]')
        self.field, self.members, self.n_particles = field, members, n_particles
        self.form = FORMS[field.tool.name](field, members)
        self.variables = field.network.trainable_variables
        limits = quality.limits(field.ranges, field.tool.scalars)
        self._limits = limits.astype(np.float32)
        self._concrete: dict[str, dict] = {}

    def start(self, **given):
        """The state of a tool that has not moved yet.

        Args:
          pose: float32 [7], position (m) and unit quaternion (w, x, y, z).
          position_low: float32 [3], what float32 cuts off the position, m; or zeros.
          velocity: float32 [6], linear and angular, m/s and rad/s.
          surface: float32 [n], height of the bed at `bin_offsets` from the tool along its way, m.
          level: float32 [], median height of the bed, m.
          end: float32 [], from the tool to the end of the bed along its way, m.
          floor: float32 [], height of the floor, m.
          and `pose_inputs` and `start_inputs` of the tool's `Form`.

        Returns:
          dict of `bins` [k, n], `tool` [K] and `status` [].
        """
        bins, tool, is_good = self.form.begun(given)
        is_good &= _is_given(given)
        return {
            'bins': tf.where(is_good, bins, tf.zeros_like(bins)),
            'tool': tf.where(is_good, tool, tf.zeros_like(tool)),
            'status': tf.where(is_good, STATUS['ok'], STATUS['refused']),
        }

    def step(self, bins, tool, **given):
        """The tool goes straight to its next pose; what cannot be leaves the state as it is, and
        the loads are again those of the frame before.

        Args:
          bins, tool: the state.
          pose, position_low: see `start`.
          dt: float32 [], s.
          and `pose_inputs` and `step_inputs` of the tool's `Form`.

        Returns:
          dict of the state, `next_bins` and `next_tool`; `force` [3] (N) and `torque` [3] (N m)
          about the tool's reference point, world; `bound` [] (N) of the force error, where the
          model has one; `status` []; `outside` [S], by how much each scalar of the frame leaves
          its training range; and `Form.outputs`.
        """
        field = self.field
        bins, tool, is_whole = field_state.sane(bins, tool)
        next_bins, next_tool, is_good = self.form.moved(bins, tool, given)
        is_good &= is_whole & _is_given(given) & (given['dt'] > 0)
        bins, tool = tf.where(is_good, next_bins, bins), tf.where(is_good, next_tool, tool)
        frame = self.form.frame(bins, tool)
        loads = field.network.force(frame.bins, frame.scalars, self.members)
        loads = tf.where(is_whole, loads, tf.zeros_like(loads))
        force, torque = field.axes.world_loads(tf.reduce_mean(loads, axis=0)[0], tensors)
        least, most = self._limits
        scalars = frame.scalars[0]
        outside = tf.maximum(tf.maximum(least - scalars, scalars - most), 0.0)
        status = tf.where(tf.reduce_any(outside > 0), STATUS['extrapolating'], STATUS['ok'])
        status = tf.where(field_state.is_sane(loads), status, STATUS['non_finite'])
        found = {
            'next_bins': bins,
            'next_tool': tool,
            'force': force,
            'torque': torque,
            'status': tf.where(is_good, status, STATUS['refused']),
            'outside': outside,
            **self.form.outputs(tool),
        }
        if (weights := field.calibration.get('force')) is not None:
            spread, size = (f(loads[..., :2], tensors) for f in (quality.spread, quality.size))
            found['bound'] = quality.bound(spread, size, weights, tensors)[0]
        return found

    def particles(self, bins, tool, rest):
        """Where particles are in the newest frame; none of those that moved is inside the tool.

        Args:
          bins, tool: the state.
          rest: float32 [P, 3], m, where they were at the start.

        Returns:
          dict of `particles` [P, 3], m; what is not finite of `rest` comes back as it is.
        """
        field, at = self.field, self.form.at
        bins, tool, is_whole = field_state.sane(bins, tool)
        is_sane = tf.reduce_all(tf.abs(rest) <= LARGEST, axis=1, keepdims=True) & is_whole
        places = field.axes.points(tf.where(is_sane, rest, 0.0), tensors)
        frame = self.form.frame(bins, tool)
        local = places - tf.stack([tool[at['origin']], tool[at['level']], 0.0])
        moved = field.network.displacement(frame.bins, frame.scalars, local[None], self.members)
        # As `FieldSoil`: those that rest stay as they were given, to the last bit.
        has_moved = tf.reduce_any(moved[:, 0] != 0.0, axis=[0, 2])[:, None]
        moved = tf.reduce_mean(moved, axis=0)[0]
        way = self.form.way_out(tool, places + moved)
        shift = field.axes.world(moved + way, tensors)
        return {'particles': tf.where(has_moved & is_sane, rest + shift, rest)}

    @property
    def pose_shapes(self) -> dict[str, list[int]]:
        """Name -> shape of the inputs that a pose is."""
        return {'pose': [7], 'position_low': [3]} | self.form.pose_inputs

    def signatures(self) -> dict[str, dict[str, tf.TensorSpec]]:
        """Name of a function -> its inputs by name."""
        n = len(self.field.grid.offsets)
        form = self.form
        state = {'bins': [len(form.bins), n], 'tool': [len(form.tool)]}
        pose = self.pose_shapes
        bed = {'surface': [n], 'level': [], 'end': [], 'floor': []}
        shapes: dict[str, dict[str, list[int]]] = {
            'start': pose | {'velocity': [6]} | form.start_inputs | bed,
            'step': state | pose | form.step_inputs | {'dt': []},
            'particles': state | {'rest': [self.n_particles, 3]},
        }
        return {
            function: {name: tf.TensorSpec(s, tf.float32, name=name) for name, s in rows.items()}
            for function, rows in shapes.items()
        }

    def describe(self, kind: str) -> dict:
        """What a user of the exported model must know; JSON-able."""
        return field_description.describe(self, kind)

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


def _is_given(given):
    """Bool []: finite inputs, and a pose as `live.poses` asks for; float32 cuts less than this off
    any place in a scene and off any quaternion."""
    is_good = tf.constant(True)
    for name, values in given.items():
        most = 1e-3 if name.endswith('_low') else LARGEST
        is_good &= tf.reduce_all(tf.abs(values) <= most)
    length = tf.sqrt(tf.reduce_sum(given['pose'][3:] ** 2))
    return is_good & (tf.abs(length - 1.0) <= UNIT_TOLERANCE)
