"""What the networks of a wheel's field see, and where they may say anything; TensorFlow.

The force and the height see the drive alone, see `wheel_path`; the particles see the rut as well.
Places are seen in lengths of the contact, loads over the first load, the first load over the weight
of a block of soil: what is alike in wheels of other sizes and on other planets looks alike.
"""

import numpy as np
import tensorflow as tf

from learning_to_simulate.methods.swept_field import wheel_path
from learning_to_simulate.methods.swept_field.inputs import at_places, gate_of

# Density of the soil that loads are compared with, kg/m3.
DENSITY = 1700.0
# Offsets at which the drive is seen, in halves of the contact, and the rut and the slip, m.
AT_CONTACT = np.array([-3.0, -2.0, -1.4, -1.0, -0.6, -0.25, 0.0, 0.25, 0.6, 1.0, 1.4, 2.0])
AROUND = np.array([-0.12, -0.075, -0.045, -0.025, -0.01, 0.0, 0.01, 0.025, 0.045, 0.075, 0.12])
SLIP_AROUND = np.array([-0.06, -0.025, 0.0, 0.025, 0.06])
# The last passage fades over so much travel, slip is mobilised over so much, m.
RECENT, SHEARED = 0.05, 0.004
# Soil that lies this far below what may have moved rests, m; above it its share grows.
BELOW, BELOW_RAMP = 0.05, 0.02
# ... and this far beside the wheel.
BESIDE, BESIDE_RAMP = 0.08, 0.03
# Displacements are of this order, m; the vertical force departs from the load by this share.
DISPLACEMENT, VERTICAL = 0.01, 0.05
LEAST_SUNK = 0.002  # m, added to the first sinkage where changes are compared with it
# Drawbar, vertical force, torque, change of height.
OUTPUTS = 4

_S = {name: i for i, name in enumerate(wheel_path.SCALARS)}
_C = wheel_path


class WheelInputs:
    """The inputs of one grid of bins, and what the outputs mean; as `inputs.Inputs`.

    Args:
      grid: `swept_features.SweptGrid`.

    Attributes:
      outputs, displacement: see there.
    """

    outputs = OUTPUTS
    displacement = DISPLACEMENT

    def __init__(self, grid):
        self._first, self._spacing = float(grid.offsets[0]), grid.spacing

    def _at(self, bins, places):
        """Channels at places [B, ...], m from the wheel's first."""
        return at_places(bins, (places - self._first) / self._spacing)

    def gate(self, bins, scalars, rest):
        """Share in [0, 1] of its displacement that a particle may show; arguments as of
        `inputs.Inputs.gate`."""
        here, half = self._at(bins, rest[..., 0]), _scalar(scalars, 'half_width')
        return gate_of(here, _C, half, rest, (BELOW, BELOW_RAMP), (BESIDE, BESIDE_RAMP))

    def particles(self, bins, scalars, rest):
        """Inputs [B, P, I] of particles; arguments as of `gate`."""
        u, y, z = tf.unstack(rest, axis=-1)
        tip, height, half, radius, contact, sunk, load = (
            _scalar(scalars, name)
            for name in ('tip', 'height', 'half_width', 'radius', 'contact', 'sunk', 'first_load')
        )
        behind, beside = tip - u, tf.abs(z)
        seen = bins[..., : _C.SINCE]  # cut, surface, first cut
        around = self._at(seen, u[..., None] + tf.constant(AROUND, tf.float32))
        middle = around[..., len(AROUND) // 2, :]
        cut, surface = middle[..., _C.CUT], middle[..., _C.SURFACE]
        places = u[..., None] + tf.constant(SLIP_AROUND, tf.float32)
        slips = self._at(bins[..., _C.SINCE : _C.INFLUENCE], places)
        since, slid, shear, peak = tf.unstack(slips, axis=-1)
        above = y - surface + cut
        # How far the particle is from the rim, now and when the wheel was set down.
        from_rim = tf.sqrt(behind**2 + (y - height) ** 2 + 1e-8) - radius
        at_first = tf.sqrt(u**2 + (y - radius + sunk) ** 2 + 1e-8) - radius
        foremost, rearmost = _scalar(scalars, 'foremost') - u, _scalar(scalars, 'rearmost') - u
        columns = [
            behind / 0.1, tf.tanh(behind / 0.015), tf.tanh(behind / contact),
            *(tf.exp(-((behind / contact - c) ** 2)) for c in (-1.0, 0.0, 1.0)),
            u / 0.1, tf.tanh(u / contact), tf.tanh(foremost / contact), tf.tanh(rearmost / contact),
            (y - surface) / 0.03, tf.tanh((y - surface) / 0.01), (y - height + radius) / 0.03,
            from_rim / 0.03, tf.tanh(from_rim / 0.01), tf.tanh(at_first / 0.01),
            beside / 0.06, tf.tanh((beside - half) / 0.015), tf.tanh((beside - half) / 0.04),
            above / 0.02, tf.tanh(above / 0.005),
            _scalar(scalars, 'end') - u,
        ]  # fmt: skip
        new = around[..., _C.CUT] - around[..., _C.FIRST_CUT]
        per_particle = tf.concat(
            [
                tf.stack(columns, axis=-1),
                around[..., _C.CUT] / 0.02,
                new / 0.01,
                (around[..., _C.SURFACE] - surface[..., None]) / 0.02,
                tf.exp(-since / RECENT),
                tf.math.log1p(slid / SHEARED),
                tf.tanh(shear / SHEARED),
                shear / 0.03,
                peak / load[..., None],
            ],
            axis=-1,
        )
        shared = tf.concat(
            [self._of_drive(scalars), (_scalar(scalars, 'height') - radius) / 0.02], axis=-1
        )
        shape = tf.concat([tf.shape(rest)[:2], [shared.shape[-1]]], axis=0)
        return tf.concat([per_particle, tf.broadcast_to(shared[:, None], shape)], axis=-1)

    def force(self, bins, scalars):
        """Inputs [B, I] of force, torque and height: of the drive alone."""
        contact, first = _scalar(scalars, 'contact'), _scalar(scalars, 'first_load')
        places = _scalar(scalars, 'tip') + contact * tf.constant(AT_CONTACT, tf.float32)
        there = self._at(bins[..., _C.SINCE : _C.INFLUENCE], places)
        since, slid, shear, peak = tf.unstack(there, axis=-1)
        return tf.concat(
            [
                self._of_drive(scalars),
                self._rates(scalars),
                tf.exp(-since / RECENT),
                tf.math.log1p(slid / SHEARED) / 2,
                tf.tanh(shear / SHEARED),
                peak / first,
                tf.tanh((_scalar(scalars, 'end') - _scalar(scalars, 'tip')) / 0.1),
            ],
            axis=-1,
        )

    def load_share(self, bins, scalars):
        """[B, 3] load (N), load times radius (N m), and what changes of the height are compared
        with (m), which is 0 until the wheel stirs."""
        s = {name: scalars[:, i] for name, i in _S.items()}
        sinkage = s['stirred'] * (tf.nn.relu(s['sunk']) + LEAST_SUNK)
        return tf.stack([s['frame_load'], s['frame_load'] * s['radius'], sinkage], axis=-1)

    def load_of(self, found, share):
        """Force along the way and up (N), torque in their plane (N m) and change of the height (m),
        [M, B, 4], from outputs [M, B, 4] and `load_share`: the wheel bears its load."""
        load, moment, sinkage = tf.unstack(share[None], axis=-1)
        return tf.stack(
            [
                load * found[..., 0],
                load * (1.0 + VERTICAL * found[..., 1]),
                moment * found[..., 2],
                sinkage * found[..., 3],
            ],
            axis=-1,
        )

    def _of_drive(self, scalars):
        """Inputs [B, I] that say what wheel it is, on what soil, and how far it has gone.

        Few, and without dimension: with gravity, radius, width and load each for itself (and
        distances in metres) the sinkage of unseen wheels was worse by a fifth.
        """
        s = {name: scalars[:, i] for name, i in _S.items()}
        weight = DENSITY * s['gravity'] * s['radius'] ** 2 * 2 * s['half_width']
        contact = s['contact']
        columns = [
            tf.math.log(s['first_load'] / weight) / 2, (s['friction'] - 0.75) / 0.15,
            tf.math.log(s['radius'] / 0.075),
            tf.math.log(tf.maximum(s['sunk'], LEAST_SUNK) / s['radius']),
            s['load'] / s['first_load'] - 1.0, s['peak_load'] / s['first_load'] - 1.0,
            s['tip'] / contact / 3, tf.tanh(s['tip'] / contact),
            tf.tanh(tf.abs(s['tip']) / (0.3 * contact)),
            s['rolled'] / contact / 3, tf.tanh(s['rolled'] / contact),
            tf.math.log1p(s['slipped'] / SHEARED) / 2, tf.math.log1p(s['slipped'] / contact),
            tf.math.log1p(s['travelled'] / contact),
            (s['foremost'] - s['tip']) / contact, (s['tip'] - s['rearmost']) / contact,
            tf.tanh(s['foremost'] / contact), tf.tanh(s['rearmost'] / contact),
        ]  # fmt: skip
        return tf.stack(columns, axis=-1)

    def _rates(self, scalars):
        """Inputs [B, I] that say how the wheel slips and has slipped: no speed, slow soil answers
        to the path alone."""
        s = {name: scalars[:, i] for name, i in _S.items()}
        columns = []
        for ending in ('', *(f'_{i}' for i in range(len(wheel_path.TIME_SCALES)))):
            speed, rim = s['speed' + ending], s['rim' + ending]
            size = tf.sqrt(speed**2 + rim**2 + 1e-6)  # 1 mm/s
            columns += [(rim - speed) / size, rim / size, speed / size]
        return tf.stack(columns, axis=-1)


def _scalar(scalars, name):
    """One scalar of B frames, [B, 1]."""
    return scalars[:, _S[name]][:, None]
