"""What the exported functions know of a wheel.

Its path is counted from where it began, along the way and upwards from the level of the bed. What
is summed up over frames (slip of every bin, way, turn) has a second number for what float32 cuts
off: rounding would stop a sum whose frames are short.
"""

import numpy as np
import tensorflow as tf

from learning_to_simulate.export import field_state
from learning_to_simulate.methods import tensors
from learning_to_simulate.methods.swept_features import Finer
from learning_to_simulate.methods.swept_field import live, soil_physics, wheel_path
from learning_to_simulate.methods.swept_field.tool_path import Bed
from learning_to_simulate.methods.swept_field.wheel_path import DriveState, Rut

_RATES = ('speed', 'rim')
_N_SCALE = len(wheel_path.TIME_SCALES)
_MEMORY = tuple(f'{name}_{i}' for i in range(_N_SCALE) for name in _RATES)
_ROTATION = ('w', 'x', 'y', 'z')
# What is summed up: of all bins, and of the wheel.
_BIN_SUMS = ('slid', 'shear')
_SUMS = ('turned', 'travelled', 'slipped', 'loaded')
# As `numpy.isclose`, by which `LiveField` knows another planet or soil.
_NEAR, _NEAR_SHARE = 1e-8, 1e-5


def _low(names):
    return tuple(f'{name}_low' for name in names)


class WheelForm(field_state.Form):
    """See `Form`."""

    bins = ('surface', 'first', 'profile', 'since', 'peak', *_BIN_SUMS, *_low(_BIN_SUMS))
    pose_inputs = {'rotation_low': [4]}
    meaning = {
        'pose': 'position (m) and unit quaternion (w, x, y, z) of the axle, as rigid_pose of the '
        'dataset; after the start its height is ignored',
        'rotation_low': 'what float32 cuts off the quaternion: float64 minus float32; zeros cost '
        'digits of the slip where frames are short',
        'radius': 'of the wheel, m',
        'radius_low': 'what float32 cuts off the radius, m; or 0',
        'width': 'of the wheel, m',
        'context': 'in the order of context_names of scene, in their units; in a step the load may '
        'change, N',
        'height': 'of the axle, predicted, m',
    }  # fmt: skip
    refused = 'another planet or soil than at the start, a load that is not positive, '

    def __init__(self, field, members: int):
        super().__init__(field, members)
        names = field.scene.context_names
        self.start_inputs = {
            'radius': [], 'radius_low': [], 'width': [], 'context': [len(names)]
        }  # fmt: skip
        self.step_inputs = {'context': [len(names)]}
        self._load = names.index('load')
        self.tool = (
            'started', 'origin', 'origin_low', 'level', 'floor', 'end',
            'radius', 'radius_low', 'width', 'sunk', 'contact', 'first_height', 'first_load',
            *names, 'u', 'u_low', 'height', *_ROTATION, *_low(_ROTATION), *_SUMS, *_low(_SUMS),
            *_RATES, *_MEMORY, 'frame_load', 'peak_load', 'rearmost', 'foremost',
        )  # fmt: skip

    def own_inputs(self, size, context):
        """See `Form`."""
        radius = size[wheel_path.RADIUS]
        return {
            'radius': radius,
            'radius_low': radius - np.float32(radius),
            'width': size[wheel_path.WIDTH],
            'context': context,
        }

    def begun(self, given):
        """See `Form`."""
        field, context, level = self.field, given['context'], given['level']
        place, low = self._place(given)
        named = dict(zip(field.scene.context_names, tf.unstack(context), strict=True))
        gravity, load = named['gravity'], named['load']
        friction = wheel_path.friction_of(named['friction_angle_deg'], tensors)
        size = tf.stack([given['radius'], given['width'], gravity, friction])
        height = (place[1] - level) + low[1]
        zero = tf.zeros([])
        pose = tf.stack([zero, height, zero, load])[None]
        velocity = field.tool.velocity(field.axes, given['velocity'], size, tensors)
        bed = Bed((given['surface'] - level)[None], tf.zeros([1]), given['end'][None])
        none, still = tf.zeros_like(bed.surface), tf.zeros([1, 1])
        radius = given['radius'], given['radius_low']
        edge = field_state.edge(field.grid, (still, still), radius)
        drive, rut = wheel_path.start(
            field.grid, bed, size[None], pose, velocity[None], tensors, edge
        )
        values = named | {
            'started': tf.ones([]), 'origin': place[0], 'origin_low': low[0], 'level': level,
            'floor': given['floor'] - level, 'end': given['end'], 'radius': given['radius'],
            'radius_low': given['radius_low'], 'width': given['width'], 'sunk': drive.sunk[0],
            'contact': drive.contact[0], 'first_height': height, 'first_load': load,
        }  # fmt: skip
        sums = [(zero, zero)] * len(_SUMS), [(none, none)] * len(_BIN_SUMS)
        is_good = tf.reduce_all(tf.stack([given['radius'], given['width'], gravity, load]) > 0)
        return *self._packed(values, given, drive, rut, sums), is_good

    def moved(self, bins, tool, given):
        """See `Form`."""
        field, dt, context = self.field, given['dt'], given['context']
        values = dict(zip(self.tool, tf.unstack(tool), strict=True))
        drive, rut, bed = self._unpacked(bins, values)
        place, low = self._place(given)
        travel = (place[0] - values['u']) + (low[0] - values['u_low'])
        turn = self._turn(values, given)
        ends = [self._gone(values), self._gone(values | {'u': place[0], 'u_low': low[0]})]
        radius = values['radius'], values['radius_low']
        edge = tuple(field_state.edge(field.grid, end, radius) for end in ends)
        finer = Finer(tf.stack([travel, turn])[None], edge)
        turned = field_state.added(values['turned'], values['turned_low'], turn)
        load = context[self._load]
        pose = tf.stack([sum(ends[1])[0, 0], values['height'], turned[0], load])[None]
        # Of this frame alone; then on top of those before.
        none = tf.zeros_like(drive.slid)
        alone = drive._replace(way=tf.zeros_like(drive.way), slid=none, shear=none)
        after = wheel_path.drive_on(field.grid, alone, pose, dt, tensors, finer)
        way = [
            field_state.added(values[name], values[f'{name}_low'], more)
            for name, more in zip(_SUMS[1:], tf.unstack(after.way[0]), strict=True)
        ]
        of_bins = [
            field_state.added(self._row(bins, name), self._row(bins, f'{name}_low'), more)
            for name, more in zip(_BIN_SUMS, (after.slid, after.shear), strict=True)
        ]
        after = after._replace(
            way=tf.stack([high for high, _ in way])[None], slid=of_bins[0][0], shear=of_bins[1][0]
        )
        known = wheel_path.frame(field.grid, bed, after, None, tensors)
        loads = field.network.force(known.bins, known.scalars, self.members)
        height = values['first_height'] + tf.reduce_mean(loads[..., 3], axis=0)
        rut = wheel_path.sink(field.grid, after, rut, height, tensors, finer)
        then = self._packed(values, given, after, rut, ([turned, *way], of_bins))
        is_good = (
            (tf.abs(travel) <= live.FASTEST * dt)
            & (tf.abs(turn) <= live.FASTEST_TURN * dt)
            & (height[0] - values['radius'] >= values['floor'])
            & ~wheel_path.leaves_bins(field.grid, drive, pose)[0]
            & self._is_alike(values, context)
        )
        return *then, is_good

    def _is_alike(self, values, context):
        """Bool []: a context that a wheel may come to on its way."""
        is_good = context[self._load] > 0
        for i, name in enumerate(self.field.scene.context_names):
            if i != self._load:
                near = _NEAR + _NEAR_SHARE * tf.abs(values[name])
                is_good &= tf.abs(context[i] - values[name]) <= near
        return is_good

    def _place(self, given):
        """Where a pose is, along and up, and what float32 cuts off that: [2] each, m."""
        axes = self.field.axes
        position, low = given['pose'][:3], given['position_low']
        return tuple(axes.local(x, tensors)[:2] for x in (position, low))

    def _gone(self, values):
        """From the wheel's first place, m, and what float32 cuts off that: [1, 1] each."""
        ends = (values[name] for name in ('u', 'u_low', 'origin', 'origin_low'))
        return field_state.gone(*(end[None, None] for end in ends))

    def _turn(self, values, given):
        """How far the wheel rolls on from its last pose, rad."""
        rotation, low = (
            tf.stack([values[name] for name in names]) for names in (_ROTATION, _low(_ROTATION))
        )
        now, now_low = given['pose'][3:], given['rotation_low']
        # A quaternion and its negative are one rotation.
        sign = tf.where(tf.reduce_sum(rotation * now) < 0, -1.0, 1.0)
        change = (sign * now - rotation) + (sign * now_low - low)
        return -self.field.axes.turns(rotation[None], change[None], tensors)[0]

    def frame(self, bins, tool):
        """See `Form`."""
        values = dict(zip(self.tool, tf.unstack(tool), strict=True))
        drive, rut, bed = self._unpacked(bins, values)
        return wheel_path.frame(self.field.grid, bed, drive, rut, tensors)

    def way_out(self, tool, points):
        """See `Form`."""
        u, height, level, radius, width = (
            tool[self.at[name]] for name in ('u', 'height', 'level', 'radius', 'width')
        )
        pose = tf.stack([u, level + height])
        return soil_physics.inside_wheel(points, pose, radius, width, tensors)[1]

    def outputs(self, tool):
        """See `Form`."""
        return {'height': tool[self.at['level']] + tool[self.at['height']]}

    def _row(self, bins, name):
        """[1, n]."""
        return bins[self.bins.index(name)][None]

    def _packed(self, values, given, drive: DriveState, rut: Rut, sums):
        """`bins` [9, n] and `tool` [K].

        Args:
          values: name -> [], what stays as it was.
          given: the inputs.
          drive, rut: of one wheel.
          sums: of `_SUMS` and of `_BIN_SUMS`, high and low.
        """
        place, low = self._place(given)
        now = {
            'load': drive.pose[0, wheel_path.LOAD], 'u': place[0], 'u_low': low[0],
            'height': rut.position[0, 1],
            'frame_load': drive.frame_load[0], 'peak_load': drive.peak_load[0],
        }  # fmt: skip
        rows = {
            _ROTATION: given['pose'][3:],
            _low(_ROTATION): given['rotation_low'],
            _RATES: drive.velocity[0],
            _MEMORY: tf.reshape(drive.memory, [-1]),
            ('rearmost', 'foremost'): drive.reach[0],
        }
        for names, row in rows.items():
            now |= dict(zip(names, tf.unstack(row), strict=True))
        for name, (high, low) in zip(_SUMS, sums[0], strict=True):
            now |= {name: high, f'{name}_low': low}
        values = values | now
        since = tf.minimum(drive.since, self.field.grid.forget)
        (slid, slid_low), (shear, shear_low) = sums[1]
        bins = [
            rut.surface, rut.first, rut.profile, since, drive.peak, slid, shear, slid_low, shear_low
        ]  # fmt: skip
        return tf.concat(bins, axis=0), tf.stack([values[name] for name in self.tool])

    def _unpacked(self, bins, values):
        """`DriveState`, `Rut` and `Bed` of one wheel, places from its first one and the level."""

        def of(*names):
            return tf.stack([values[name] for name in names])[None]

        zero = tf.zeros([])
        place = sum(self._gone(values))[0, 0]
        friction = wheel_path.friction_of(values['friction_angle_deg'], tensors)
        drive = DriveState(
            size=tf.stack([values['radius'], values['width'], values['gravity'], friction])[None],
            first=tf.stack([zero, values['first_height'], zero, values['first_load']])[None],
            sunk=of('sunk')[0],
            contact=of('contact')[0],
            pose=tf.stack([place, values['height'], values['turned'], values['load']])[None],
            velocity=of(*_RATES),
            memory=tf.reshape(of(*_MEMORY), [1, _N_SCALE, len(_RATES)]),
            frame_load=of('frame_load')[0],
            peak_load=of('peak_load')[0],
            reach=of('rearmost', 'foremost'),
            way=of(*_SUMS[1:]),
            **{name: self._row(bins, name) for name in ('since', 'peak', *_BIN_SUMS)},
        )
        position = drive.pose[:, :2]
        rut = Rut(*(self._row(bins, name) for name in ('surface', 'first', 'profile')), position)
        return drive, rut, Bed(rut.surface, tf.zeros([1]), of('end')[0])
