"""What the networks of a swept field see, and where they may say anything; TensorFlow.

Lengths are divided by what is typical of them, so that inputs are of order one. Places across the
blade enter by their distance from its middle plane, so the field is symmetric about it.
"""

import numpy as np
import tensorflow as tf

from learning_to_simulate.methods.swept_field import tool_path

# Offsets along the way at which the profile is seen, m: around a particle, and around the tool for
# the force.
AROUND = np.array([-0.2, -0.13, -0.085, -0.055, -0.035, -0.017, 0.0, 0.017, 0.035, 0.055, 0.085,
                   0.13, 0.2])  # fmt: skip
SINCE_AROUND = np.array([-0.1, -0.04, 0.0, 0.04, 0.1])
AT_EDGE = np.array([-0.16, -0.1, -0.06, -0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04, 0.07, 0.11,
                    0.16])  # fmt: skip
# The tool's last passage fades over so much travel, m.
RECENT = 0.15
BUMPS, BUMP_WIDTH = np.array([-0.08, 0.0, 0.08]), 0.05
# Soil that lies this far below what may have moved rests, m; above it its share grows.
BELOW, BELOW_RAMP = 0.05, 0.03
# ... and this far beside the blade.
BESIDE, BESIDE_RAMP = 0.3, 0.05
# A heap of a swept area stands at most so high above the surface, in roots of the area: a slope of
# 35 degrees on one side of an upright wall.
HEAP_HEIGHT = float(np.sqrt(2.0 * np.tan(np.radians(35.0))))
CONTACT_ABOVE, CONTACT_RAMP = 0.02, 0.01
# Displacements and forces are of the order of these: m, N, N m, for a blade of this width, m.
DISPLACEMENT, FORCE, TORQUE, WIDTH = 0.03, 100.0, 10.0, 0.4
# The load grows a hundredfold where the tool is pressed down: beside its three components the
# network gives the logarithm of a gain, within these limits.
OUTPUTS = 4
GAIN_LIMIT = 4.0
CONTACT_AROUND = np.array([-0.06, -0.03, 0.0, 0.03, 0.06])

_S = {name: i for i, name in enumerate(tool_path.SCALARS)}
_C = tool_path
# The first channels: cut and surface.
_PROFILES = 2


def at_places(bins, places):
    """Channels of bins at places, linear between them.

    Args:
      bins: [B, n, C].
      places: [B, ...] in bins; beyond the ends, the ends.

    Returns:
      [B, ..., C].
    """
    last = tf.cast(tf.shape(bins)[1] - 1, tf.float32)
    places = tf.clip_by_value(places, 0.0, last)
    low = tf.minimum(tf.floor(places), last - 1.0)
    index, share = tf.cast(low, tf.int32), (places - low)[..., None]
    return (1.0 - share) * tf.gather(bins, index, batch_dims=1) + share * tf.gather(
        bins, index + 1, batch_dims=1
    )


def gate_of(here, channels, half_width, rest, below, beside):
    """Share [B, P] in [0, 1] of its displacement that a particle may show; exactly 0 where nothing
    has been. Of a blade and of a wheel.

    Args:
      here: [B, P, channels] at the places of the particles.
      channels: module that names them: SURFACE, DISTURBED, INFLUENCE.
      half_width: [B, 1] of the tool, m.
      rest: [B, P, 3] u from the tool's first place, height over the level, distance from the
        middle plane (signed), m.
      below, beside: how far soil moves below what may have been disturbed and beside the tool, and
        over what way its share grows, m each.
    """
    depth = here[..., channels.SURFACE] - rest[..., 1]
    under = (here[..., channels.DISTURBED] + below[0] - depth) / below[1]
    across = (half_width + beside[0] - tf.abs(rest[..., 2])) / beside[1]
    return (
        here[..., channels.INFLUENCE]
        * tf.clip_by_value(under, 0.0, 1.0)
        * tf.clip_by_value(across, 0.0, 1.0)
    )


class Inputs:
    """The inputs of one grid of bins, and what the outputs mean.

    Args:
      grid: `swept_features.SweptGrid`.
      radius: of the blade's edge, m.

    Attributes:
      outputs: of the network of the load.
      displacement: m, unit of that of the particles.
    """

    outputs = OUTPUTS
    displacement = DISPLACEMENT

    def __init__(self, grid, radius: float):
        self._first, self._spacing = float(grid.offsets[0]), grid.spacing
        self._radius, self._forget = radius, grid.forget

    def _at(self, bins, places):
        """Channels at places [B, ...], m from the tool's first."""
        return at_places(bins, (places - self._first) / self._spacing)

    def gate(self, bins, scalars, rest):
        """Share in [0, 1] of its displacement that a particle may show; exactly 0 where nothing has
        been.

        Args:
          bins, scalars: of B frames, see `tool_path.Frame`.
          rest: [B, P, 3] u from the tool's first place, height over the level, distance from the
            middle plane (signed), m.

        Returns:
          [B, P].
        """
        here, half = self._at(bins, rest[..., 0]), _scalar(scalars, 'half_width')
        return gate_of(here, _C, half, rest, (BELOW, BELOW_RAMP), (BESIDE, BESIDE_RAMP))

    def particles(self, bins, scalars, rest):
        """Inputs [B, P, I] of particles; arguments as of `gate`."""
        u, y, z = tf.unstack(rest, axis=-1)
        tip, height, half = (_scalar(scalars, n) for n in ('tip', 'height', 'half_width'))
        behind, beside = tip - u, tf.abs(z)
        around = self._at(bins[..., :_PROFILES], u[..., None] + tf.constant(AROUND, tf.float32))
        middle = around[..., len(AROUND) // 2, :]
        cut, surface = middle[..., _C.CUT], middle[..., _C.SURFACE]
        area_before = self._at(bins[..., _C.AREA_BEFORE, None], u)[..., 0]
        above = y - surface + cut  # over the deepest cut at its place
        places = u[..., None] + tf.constant(SINCE_AROUND, tf.float32)
        since = self._at(bins[..., _C.SINCE, None], places)[..., 0]
        bumps = [tf.exp(-(((behind - c) / BUMP_WIDTH) ** 2)) for c in BUMPS]
        foremost = _scalar(scalars, 'foremost') - u
        columns = [
            behind / 0.15, tf.tanh(behind / 0.03), *bumps,
            (y - surface) / 0.05, (y - height) / 0.05, tf.tanh((y - height) / 0.02),
            beside / 0.15, tf.tanh((beside - half) / 0.03), tf.tanh((beside - half) / 0.1),
            above / 0.05, tf.tanh(above / 0.01),
            foremost / 0.15, tf.tanh(foremost / 0.03),
            area_before / 0.01, tf.sqrt(area_before + 1e-6) / 0.1,
            _scalar(scalars, 'end') - u,
            # Sharper where a particle is carried along or left: the ends of the edge, the cut.
            tf.tanh((beside - half) / 0.008), tf.exp(-(((beside - half) / 0.02) ** 2)),
            tf.tanh(above / 0.004), tf.exp(-((above / 0.012) ** 2)),
        ]  # fmt: skip
        per_particle = tf.concat(
            [
                tf.stack(columns, axis=-1),
                around[..., _C.CUT] / 0.03,
                (around[..., _C.SURFACE] - surface[..., None]) / 0.03,
                tf.exp(-since / RECENT),
            ],
            axis=-1,
        )
        shared = self._of_tool(scalars)
        shape = tf.concat([tf.shape(rest)[:2], [shared.shape[-1]]], axis=0)
        return tf.concat([per_particle, tf.broadcast_to(shared[:, None], shape)], axis=-1)

    def contact(self, bins, scalars):
        """Share [B] in [0, 1] of its force that a tool may show; exactly 0 in the air."""
        places = _scalar(scalars, 'tip') + tf.constant(CONTACT_AROUND, tf.float32)
        surface = tf.reduce_max(self._at(bins, places)[..., _C.SURFACE], axis=-1)
        heap = HEAP_HEIGHT * tf.sqrt(tf.maximum(scalars[:, _S['area']], 0.0))
        clearance = scalars[:, _S['height']] - self._radius - surface
        return tf.clip_by_value((heap + CONTACT_ABOVE - clearance) / CONTACT_RAMP, 0.0, 1.0)

    def force(self, bins, scalars):
        """Inputs [B, I] of the force on the tool."""
        places = _scalar(scalars, 'tip') + tf.constant(AT_EDGE, tf.float32)
        there = self._at(bins, places)
        height = scalars[:, _S['height']][:, None]
        low = there[..., _C.SURFACE] - there[..., _C.CUT]
        depth = tf.nn.relu(there[..., len(AT_EDGE) // 2, _C.SURFACE][:, None] - height) / 0.05
        speed = scalars[:, _S['speed'] : _S['speed'] + 2]
        size = tf.sqrt(tf.reduce_sum(speed**2, axis=1, keepdims=True) + 1e-8)
        end = scalars[:, _S['end']] - scalars[:, _S['tip']]
        return tf.concat(
            [
                self._of_tool(scalars),
                self._rates(scalars),
                there[..., _C.CUT] / 0.03,
                (there[..., _C.SURFACE] - height) / 0.05,
                tf.tanh((low - height) / 0.02),
                tf.exp(-there[..., _C.SINCE] / RECENT),
                depth, depth**2,
                speed / size, tf.math.log(size / 0.03), size / 0.1,
                tf.tanh(end[:, None] / 0.1),
            ],
            axis=-1,
        )  # fmt: skip

    def load_share(self, bins, scalars):
        """[B, 1] that a load is multiplied by: exactly 0 in the air, in proportion to the width."""
        return (self.contact(bins, scalars) * 2.0 * scalars[:, _S['half_width']] / WIDTH)[:, None]

    def load_of(self, found, share):
        """Force along the way and up (N) and torque in their plane (N m), [M, B, 3], from outputs
        [M, B, 4] and `load_share`."""
        gain = tf.exp(tf.clip_by_value(found[..., 3:], -GAIN_LIMIT, GAIN_LIMIT))
        return found[..., :3] * gain * share[None] * tf.constant([FORCE, FORCE, TORQUE])

    def _of_tool(self, scalars):
        """Inputs [B, I] that say how the tool stands. Particles do not see how it moves: slow soil
        answers to the path alone."""
        s = {name: scalars[:, i] for name, i in _S.items()}
        columns = [
            s['height'] / 0.05, tf.nn.relu(s['height']) / 0.03, s['lean'],
            s['area'] / 0.01, tf.sqrt(tf.nn.relu(s['area']) + 1e-6) / 0.1,
            (s['foremost'] - s['tip']) / 0.1, s['half_width'] / 0.2, s['end'] - s['tip'],
        ]  # fmt: skip
        return tf.stack(columns, axis=-1)

    def _rates(self, scalars):
        """Inputs [B, I] that say how the tool moves and has moved."""
        s = {name: scalars[:, i] for name, i in _S.items()}
        rates = {'speed': 0.1, 'rise': 0.1, 'turn': 1.0}
        columns = [tf.tanh(s['speed'] / 0.02), tf.tanh(s['rise'] / 0.02)]
        for ending in ('', *(f'_{i}' for i in range(len(tool_path.TIME_SCALES)))):
            columns += [s[name + ending] / scale for name, scale in rates.items()]
        return tf.stack(columns, axis=-1)


def _scalar(scalars, name):
    """One scalar of B frames, [B, 1]."""
    return scalars[:, _S[name]][:, None]
