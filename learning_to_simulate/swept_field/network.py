"""Both networks of a swept field, all members at once, and what they see and say; TensorFlow.

With f the network of a particle, g its gate (10), n and b outputs of the network of the load and
kappa the share of contact (13) (numbers of docs/swept_field.md):

  displacement   g D (1, 1, clip(z / ACROSS, -1, 1)) f, D = `tool.displacement`                (11)
  of a blade     kappa (w / WIDTH) exp(clip(b, -4, 4)) (FORCE, FORCE, TORQUE) n                (14)
  of a wheel     N n_1, N (1 + VERTICAL n_2), N R n_3, and of its height
                 k (sunk_0 + LEAST_SUNK) n_4, with N the mean load of the frame                (19)

Motion across is odd in the distance z from the middle plane, of which the inputs see the size only:
the field is symmetric about the plane.
"""

import numpy as np
import tensorflow as tf

from learning_to_simulate.ensemble import Members, column
from learning_to_simulate.tool import blade, inputs, wheel
from learning_to_simulate.tool.swept import Frame

OUTPUTS = 3
LOAD_HIDDEN = [64, 64]  # layers of the network of force and torque
# Motion across grows over so much distance from the middle plane, where it is odd, m.
ACROSS = 0.05


class Inputs:
    """Reads the tables of a tool, and says what the outputs of its networks mean.

    Args:
      tool: of the field.
      grid: `swept.SweptGrid`.

    Attributes:
      sizes: numbers of inputs of the particles' and of the force's network.
      displacement: m, unit of that of the particles.
    """

    def __init__(self, tool, grid):
        self._tool = tool
        self._first, self._spacing = float(grid.offsets[0]), grid.spacing
        tables = tool.tables
        self.sizes = len(tables.own) + len(tables.shared), len(tables.force)
        self.displacement = tool.displacement

    def _at(self, bins, channels, places):
        """Channels of bins [B, n, C] at places [B, ...], m from the tool's first, linear between
        bins; beyond the ends, the ends. Name -> [B, ...]."""
        seen = tf.stack([bins[..., self._tool.channels.index(c)] for c in channels], axis=-1)
        last = tf.cast(tf.shape(bins)[1] - 1, tf.float32)
        places = tf.clip_by_value((places - self._first) / self._spacing, 0.0, last)
        low = tf.minimum(tf.floor(places), last - 1.0)
        index, share = tf.cast(low, tf.int32), (places - low)[..., None]
        found = (1.0 - share) * tf.gather(seen, index, batch_dims=1) + share * tf.gather(
            seen, index + 1, batch_dims=1
        )
        return dict(zip(channels, tf.unstack(found, axis=-1)))

    def _read(self, table, bins, scalars, rest=None):
        """Inputs [B, I], or of particles [B, P, I]; see `tool.inputs.Row`."""
        names = self._tool.scalars
        last = scalars[:, None] if rest is not None else scalars
        values = {name: last[..., i, None] for i, name in enumerate(names)}
        if rest is not None:
            values |= dict(zip('uyz', tf.split(rest, 3, axis=-1)))
            operands = [row.operand for row in table.rows]
            here = {n for text in operands for n in inputs.names(text)} & set(self._tool.channels)
            found = self._at(bins, sorted(here), rest[..., 0])
            values |= {name: value[..., None] for name, value in found.items()}
        unit = values[table.unit] if table.unit else 1.0
        at = {
            offsets: self._at(
                bins, channels, values[table.place] + unit * tf.constant(offsets, tf.float32)
            )
            for offsets, channels in table.offsets().items()
        }
        columns = []
        for row in table.rows:
            there = {f'at.{name}': value for name, value in at.get(row.at, {}).items()}
            columns.append(column(row, values | there))
        return tf.concat(columns, axis=-1)

    def gate(self, bins, scalars, rest):
        """Share in [0, 1] of its displacement that a particle may show; exactly 0 where nothing has
        been: (10).

        Args:
          bins, scalars: of B frames, see `swept.Frame`.
          rest: [B, P, 3] u from the tool's first place, height over the level, distance from the
            middle plane (signed), m.

        Returns:
          [B, P].
        """
        tool = self._tool
        here = self._at(bins, ('surface', 'influence', 'disturbed'), rest[..., 0])
        depth = here['surface'] - rest[..., 1]
        under = (here['disturbed'] + tool.below - depth) / tool.below_ramp
        half = _scalar(tool, scalars, 'half_width')
        across = (half + tool.beside - tf.abs(rest[..., 2])) / tool.beside_ramp
        return (
            here['influence']
            * tf.clip_by_value(under, 0.0, 1.0)
            * tf.clip_by_value(across, 0.0, 1.0)
        )

    def particles(self, bins, scalars, rest):
        """Inputs [B, P, I] of particles; arguments as of `gate`."""
        tables = self._tool.tables
        own = self._read(tables.own, bins, scalars, rest)
        shared = self._read(tables.shared, bins, scalars)
        shape = tf.concat([tf.shape(rest)[:2], [shared.shape[-1]]], axis=0)
        return tf.concat([own, tf.broadcast_to(shared[:, None], shape)], axis=-1)

    def force(self, bins, scalars):
        """Inputs [B, I] of the load."""
        return self._read(self._tool.tables.force, bins, scalars)


class BladeInputs(Inputs):
    """Those of a blade."""

    def contact(self, bins, scalars):
        """Share [B] in [0, 1] of its force that a tool may show; exactly 0 in the air: (13)."""
        tool = self._tool
        places = _scalar(tool, scalars, 'tip') + tf.constant(blade.CONTACT_AROUND, tf.float32)
        surface = tf.reduce_max(self._at(bins, ('surface',), places)['surface'], axis=-1)
        area, height = (scalars[:, tool.scalars.index(name)] for name in ('area', 'height'))
        heap = blade.HEAP_HEIGHT * tf.sqrt(tf.maximum(area, 0.0))
        clearance = height - tool.radius - surface
        share = (heap + blade.CONTACT_ABOVE - clearance) / blade.CONTACT_RAMP
        return tf.clip_by_value(share, 0.0, 1.0)

    def load_share(self, bins, scalars):
        """[B, 1] that a load is multiplied by: exactly 0 in the air, in proportion to the width."""
        half = scalars[:, self._tool.scalars.index('half_width')]
        return (self.contact(bins, scalars) * 2.0 * half / blade.WIDTH)[:, None]

    def load_of(self, found, share):
        """Force along the way and up (N) and torque in their plane (N m), [M, B, 3], from outputs
        [M, B, 4] and `load_share`: (14)."""
        gain = tf.exp(tf.clip_by_value(found[..., 3:], -blade.GAIN_LIMIT, blade.GAIN_LIMIT))
        unit = tf.constant([blade.FORCE, blade.FORCE, blade.TORQUE])
        return found[..., :3] * gain * share[None] * unit


class WheelInputs(Inputs):
    """Those of a wheel."""

    def load_share(self, bins, scalars):
        """[B, 3] load (N), load times radius (N m), and what changes of the height are compared
        with (m), which is 0 until the wheel stirs."""
        s = dict(zip(self._tool.scalars, tf.unstack(scalars, axis=-1)))
        sinkage = s['stirred'] * (tf.nn.relu(s['sunk']) + wheel.LEAST_SUNK)
        return tf.stack([s['frame_load'], s['frame_load'] * s['radius'], sinkage], axis=-1)

    def load_of(self, found, share):
        """Force along the way and up (N), torque in their plane (N m) and change of the height (m),
        [M, B, 4], from outputs [M, B, 4] and `load_share`: (19), the wheel bears its load."""
        load, moment, sinkage = tf.unstack(share[None], axis=-1)
        return tf.stack(
            [
                load * found[..., 0],
                load * (1.0 + wheel.VERTICAL * found[..., 1]),
                moment * found[..., 2],
                sinkage * found[..., 3],
            ],
            axis=-1,
        )


_INPUTS = {'blade': BladeInputs, 'wheel': WheelInputs}


def _scalar(tool, scalars, name):
    """One scalar of B frames, [B, 1]."""
    return scalars[:, tool.scalars.index(name)][:, None]


class FieldNetwork(tf.Module):
    """Displacement of particles, force and torque on the tool.

    Args:
      config: `SweptFieldConfig`.
      tool: of the field.
      grid: bins of its path.
    """

    def __init__(self, config, tool, grid):
        super().__init__(name='field')
        self.inputs = _INPUTS[tool.name](tool, grid)
        self.sizes = self.inputs.sizes
        hidden = [config.latent_size] * config.hidden_layers
        m = config.members
        self.soil = Members(m, [self.sizes[0], *hidden, OUTPUTS], 2 * config.seed, 'soil')
        self.load = Members(
            m, [self.sizes[1], *LOAD_HIDDEN, tool.outputs], 2 * config.seed + 1, 'load'
        )

    def displacement(self, bins, scalars, rest, members: int | None = None):
        """Displacement [M, B, P, 3] (m; along the way, up, across) of particles: (11); arguments
        as of `Inputs.gate`."""
        gate = self.inputs.gate(bins, scalars, rest)
        seen = self.inputs.particles(bins, scalars, rest)
        flat = tf.reshape(seen, [-1, self.sizes[0]])
        moved = self.soil(flat, members)
        shape = tf.concat([[tf.shape(moved)[0]], tf.shape(rest)], axis=0)
        moved = tf.reshape(moved, shape) * gate[None, ..., None]
        across = tf.clip_by_value(rest[..., 2:] / ACROSS, -1.0, 1.0)
        odd = tf.concat([tf.ones_like(rest[..., :2]), across], axis=-1)
        return self.inputs.displacement * moved * odd[None]

    def force(self, bins, scalars, members: int | None = None):
        """Force along the way and up (N), torque in their plane (N m), of a wheel the change of its
        height (m): [M, B, 3 or 4]; (14) or (19)."""
        share = self.inputs.load_share(bins, scalars)
        return self.load_of(self.inputs.force(bins, scalars), share, members)

    def load_of(self, seen, share, members: int | None = None):
        """`force` from its inputs [B, I] and `Inputs.load_share` [B, k]."""
        return self.inputs.load_of(self.load(seen, members), share)


def stacked(frames) -> Frame:
    """`Frame`s of [T, ...] one behind the other."""
    return Frame(*map(np.concatenate, zip(*frames, strict=True)))
