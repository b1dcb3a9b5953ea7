"""The three networks of a soil field, all members at once, and what they see and say; TensorFlow.

A frame holds J strips with n bins each (`place`, `sweep`). Contact and load of strips and tool are
(10) to (12) of docs/soil_field.md, what the surface and a particle do (13) to (15).
"""

import functools

import numpy as np
import tensorflow as tf

from learning_to_simulate.soil_field import sweep
from learning_to_simulate.soil_field.inputs import TABLES, column
from learning_to_simulate.soil_field.place import BESIDE, N_BESIDE, Strips

FORCE, TORQUE = 100.0, 10.0  # N, N m of the field, for a tool of this width, m
WIDTH = {'blade': 0.4, 'wheel': 0.1}
GAIN_LIMIT = 4.0
LENGTH = 0.03  # m, of what soil does
AROUND_TOOL = (-0.06, -0.03, 0.0, 0.03, 0.06)
# A heap of a swept area stands at most so high above the surface, in roots of the area: a slope of
# 35 degrees on one side of an upright wall.
HEAP = float(np.sqrt(2.0 * np.tan(np.radians(35.0))))
ABOVE, RAMP = 0.02, 0.01
# Where soil is looked for that has risen under a tool in the air: along from it, m, and across, in
# half widths.
UNDER_ALONG = tuple(np.linspace(-0.1, 0.1, 11).tolist())
UNDER_ACROSS = (-0.8, -0.4, 0.0, 0.4, 0.8)
STIR = 0.005
BESIDE_RAMP = 0.05
BELOW, BELOW_RAMP = 0.05, 0.03
ACROSS = 0.05
NEIGHBOUR = 0.1  # m across, where a place looks at the terrain beside it
# Axes of the places that a method of `SoilNetworks` takes.
PLACE_AXES = {'surface_inputs': 2, 'rise': 2, 'soil_inputs': 3, 'displacement': 3}
NETWORKS = 'load', 'surface', 'soil'
# Layers of each. Three narrow ones for the load of a blade have 0.96 of the error of two wide ones;
# for a wheel, of which there are fewer runs, 1.07. With 55 units a blade's three members have more
# than 400 kB.
_PLACES = {'surface': (64, 64), 'soil': (64, 64, 64)}
HIDDEN = {'blade': {'load': (54, 48, 48), **_PLACES}, 'wheel': {'load': (64, 64), **_PLACES}}


def names_of(tool) -> tuple[str, ...]:
    """Scalars of a frame of a class of tools."""
    return (*sweep.SCALARS, *tool.scalars, *sweep.OF_PASSAGE)


class Members(tf.Module):
    """M multilayer perceptrons of one shape, evaluated together; `sizes` are of all layers, inputs
    and outputs included."""

    def __init__(self, members: int, sizes, seed: int, name: str):
        super().__init__(name=name)
        rng = np.random.Generator(np.random.Philox(key=seed))
        self.layers = []
        for i, (n_in, n_out) in enumerate(zip(sizes[:-1], sizes[1:], strict=True)):
            # The last layer begins near 0: so does the motion of the soil.
            scale = (0.1 if i == len(sizes) - 2 else 1.0) / np.sqrt(n_in)
            weight = scale * rng.standard_normal((members, n_in, n_out))
            self.layers.append(
                (
                    tf.Variable(weight, dtype=tf.float32, name=f'weight_{i}'),
                    tf.Variable(tf.zeros([members, 1, n_out]), name=f'bias_{i}'),
                )
            )

    def __call__(self, inputs, members: int | None = None):
        """Outputs [M, R, O] for inputs [R, I], the same for all; of the first members only."""
        values = inputs[None]
        for i, (weight, bias) in enumerate(self.layers):
            weight, bias = weight[:members], bias[:members]
            if i == 0:  # one product for all members: their weights side by side
                flat = tf.reshape(tf.transpose(weight, [1, 0, 2]), [weight.shape[1], -1])
                side = tf.reshape(inputs @ flat, [-1, weight.shape[0], weight.shape[2]])
                values = tf.transpose(side, [1, 0, 2]) + bias
            else:
                values = tf.matmul(tf.nn.silu(values), weight) + bias
        return values


class _Frames:
    """Methods that take frames of a tool, as functions of tensors."""

    scalars: dict[str, int]

    @functools.cache  # noqa: B019 - networks live as long as their functions
    def compiled(self, name: str, n_strips: int, members: int | None = None):
        """The method of a name as a function of tensors, compiled where it is first called: of
        frames of a number of strips, where places are asked for also of what is `placed`;
        `members` (None: all) of one that answers by members."""
        spec = tf.TensorSpec
        signature: list = [
            spec([None, n_strips, len(sweep.OFFSETS), len(sweep.CHANNELS)]),
            spec([None, n_strips, len(self.scalars)]),
        ]
        if name in PLACE_AXES:
            pair = spec([None, None], tf.int32), spec([None, None])
            signature += [spec([None, None, PLACE_AXES[name]]), [pair, pair, pair]]
        method = getattr(self, name)
        if members is not None:
            method = functools.partial(method, members=members)
        return tf.function(method, input_signature=signature, autograph=False)


class Inputs(_Frames):
    """What the networks of a tool see. It has no weights, so all fields of a tool share one, and
    what TensorFlow has traced of it."""

    def __init__(self, tool):
        self.tool, self.tables = tool, TABLES[tool.name]
        self.scalars = {n: i for i, n in enumerate(names_of(tool))}

    def _at(self, bins, names, strip, share, place):
        """Channels at places [B, P, k] (m from the origin) on strips [B, P] and their next ones by
        a share [B, P]; linear, beyond the ends the ends. Name -> [B, P, k]."""
        rows, n = tf.shape(bins)[1], tf.shape(bins)[2]
        seen = tf.gather(bins, [sweep.CHANNELS.index(c) for c in names], axis=-1)
        flat = tf.reshape(seen, [tf.shape(bins)[0], rows * n, len(names)])
        last = tf.cast(n - 1, tf.float32)
        along = tf.clip_by_value((place - float(sweep.OFFSETS[0])) / sweep.SPACING, 0.0, last)
        low = tf.minimum(tf.floor(along), last - 1.0)
        a, k = (along - low)[..., None], tf.cast(low, tf.int32)

        def row(j):
            index = j[..., None] * n + k
            near = tf.gather(flat, index, batch_dims=1)
            far = tf.gather(flat, index + 1, batch_dims=1)
            return near + a * (far - near)

        found = row(strip)
        if bins.shape[1] != 1:
            b = share[..., None, None]
            found = found + b * (row(tf.minimum(strip + 1, rows - 1)) - found)
        return dict(zip(names, tf.unstack(found, axis=-1)))

    def _read(self, table, values, look):
        """Inputs [B, P, I] of a table.

        Args:
          values: name -> [B, P] of what is the same for all offsets.
          look: names and offsets -> name -> [B, P, k].
        """
        at = {offsets: look(names, offsets) for offsets, names in table.offsets().items()}
        values = {name: values[name][..., None] for name in table.names() if name in values}
        columns = []
        for row in table.rows:
            there = {f'at.{name}': value for name, value in at.get(row.at, {}).items()}
            columns.append(column(row, values | there))
        return tf.concat(columns, axis=-1)

    def _values(self, scalars):
        return dict(zip(self.scalars, tf.unstack(scalars, axis=-1)))

    def load_inputs(self, bins, scalars):
        """What the load's network sees: own [B, K, I] of the K strips under the tool, sides
        [B, K, 2, I'] with the left and the right neighbour, kappa [B, K]: (10)."""
        under = N_BESIDE if bins.shape[1] > 1 else 0
        count = self.tool.columns if bins.shape[1] > 1 else 1
        strips = tf.range(under, under + count)[None] * tf.ones([tf.shape(bins)[0], 1], tf.int32)
        none = tf.zeros_like(strips, tf.float32)
        own = scalars[:, under : under + count]
        values = self._values(own)
        tip = values['tip']

        def look_from(j):
            def look(names, offsets):
                names = [*names, *{'surface', 'cut'} - set(names)] if 'beside' in names else names
                known = [n for n in names if n != 'beside']
                place = tip[..., None] + tf.constant(offsets, tf.float32)
                found = self._at(bins, known, strips, none, place)
                if 'beside' in names:
                    # The neighbour as it is cut by now, the profile (2).
                    other = self._at(bins, ['surface', 'cut'], j, none, place)
                    found['beside'] = other['surface'] - other['cut']
                return found

            return look

        seen = self._read(self.tables.load, values, look_from(strips))
        step = 1 if bins.shape[1] > 1 else 0
        sides = tf.stack(
            [
                self._read(self.tables.side, values, look_from(strips + sign * step))
                for sign in (-1, 1)
            ],
            axis=2,
        )
        place = tip[..., None] + tf.constant(AROUND_TOOL, tf.float32)
        highest = tf.reduce_max(self._at(bins, ['surface'], strips, none, place)['surface'], -1)
        # (10): a tool that is lifted has its load until its heap is cleared, too.
        heap = HEAP * tf.sqrt(tf.maximum(tf.maximum(values['area'], values['carried']), 0.0))
        clearance = values['height'] - values['radius'] - highest
        kappa = tf.clip_by_value((heap + ABOVE - clearance) / RAMP, 0.0, 1.0)
        return seen, sides, kappa

    def _places(self, bins, scalars, places, strips):
        """Inputs [B, P, I] of places and g (13) [B, P], and what particles need beside them."""
        (strip, share), (out, out_share), (into, into_share) = strips
        u, z = places[..., 0], places[..., -1]
        here = self._at(bins, sweep.CHANNELS, strip, share, u[..., None])
        here = {name: value[..., 0] for name, value in here.items()}
        low = tf.gather(scalars, strip, batch_dims=1)
        if bins.shape[1] != 1:
            high = tf.gather(scalars, tf.minimum(strip + 1, tf.shape(bins)[1] - 1), batch_dims=1)
            low = low + share[..., None] * (high - low)
        values = self._values(low) | here | {'u': u, 'z': z}

        def look(names, offsets):
            place = u[..., None] + tf.constant(offsets, tf.float32)
            return self._at(bins, names, strip, share, place)

        def look_at_tool(names, offsets):
            place = values['tip'][..., None] + tf.constant(offsets, tf.float32)
            return self._at(bins, names, strip, share, place)

        # The terrain beside, farther from and nearer to the middle; nothing where they change over.
        fade = tf.clip_by_value(tf.abs(z) / ACROSS, 0.0, 1.0)
        beside = [
            fade * (self._at(bins, ['surface'], j, b, u[..., None])['surface'][..., 0]
                    - here['surface']) / LENGTH
            for j, b in ((out, out_share), (into, into_share))
        ]  # fmt: skip
        seen = [
            self._read(self.tables.here, values, look),
            tf.stack(beside, axis=-1),
            self._read(self.tables.tool, values, look_at_tool),
        ]
        # g of (13): at rest far from the cut, before the first motion, and far to the side.
        across = (values['half_width'] + BESIDE - tf.abs(z)) / BESIDE_RAMP
        gate = here['influence'] * tf.clip_by_value(values['way'] / STIR, 0.0, 1.0)
        return seen, gate * tf.clip_by_value(across, 0.0, 1.0), values, look

    def surface_inputs(self, bins, scalars, places, strips):
        """What the network of the surface sees [B, P, I], and g [B, P]; arguments as of
        `SoilNetworks.rise`."""
        seen, gate, _, _ = self._places(bins, scalars, places, strips)
        return tf.concat(seen, axis=-1), gate

    def soil_inputs(self, bins, scalars, places, strips):
        """What the network of particles sees [B, P, I], and what its outputs are multiplied by
        [B, P, 3]; arguments as of `SoilNetworks.displacement`."""
        seen, gate, values, look = self._places(bins, scalars, places, strips)
        values['y'] = places[..., 1]
        seen.insert(1, self._read(self.tables.particle, values, look))
        # (15): soil well below the cones (9) rests.
        deep = values['disturbed'] + BELOW - (values['surface'] - values['y'])
        gate = gate * tf.clip_by_value(deep / BELOW_RAMP, 0.0, 1.0)
        # Motion across is odd in z: in the middle soil goes to neither side.
        odd = gate * tf.clip_by_value(values['z'] / ACROSS, -1.0, 1.0)
        return tf.concat(seen, axis=-1), tf.stack([gate, gate, odd], axis=-1)


inputs_of = functools.cache(Inputs)


class SoilNetworks(_Frames, tf.Module):
    """Load, surface and soil.

    Args:
      tool: a class of `tools.TOOLS`.
      members: M networks of each.
      seed: of their first weights.
      hidden: layers of each network.
    """

    def __init__(self, tool, members: int, seed: int, hidden=None):
        super().__init__(name='soil_field')
        hidden = HIDDEN[tool.name] if hidden is None else hidden
        self.tool, self.members, self.hidden = tool, members, hidden
        self.inputs = inputs_of(tool)
        self.scalars, t = self.inputs.scalars, self.inputs.tables
        self.sizes = {
            'load': [len(t.load) + len(t.side), *hidden['load'], 5],
            'surface': [len(t.here) + len(t.tool) + 2, *hidden['surface'], 1],
            'soil': [len(t.here) + len(t.particle) + len(t.tool) + 2, *hidden['soil'], 3],
        }
        self.load, self.surface, self.soil = (
            Members(members, sizes, 3 * seed + k, name)
            for k, (name, sizes) in enumerate(self.sizes.items())
        )

    def _seen(self, name, bins, *more):
        return self.inputs.compiled(name, bins.shape[1])(bins, *more)

    def load_of(self, seen, sides, kappa, width, members=None, borne=None):
        """[M, B, 6] force along, up, across (N) and torque along, up, across (N m) of the field,
        from `load_inputs` and widths [B]: (11), (12). Where it is known, `borne` [B] stands for the
        force up that the others of a wheel are shares of."""
        b, k = tf.shape(seen)[0], tf.shape(seen)[1]
        count = tf.cast(k, tf.float32)
        both = tf.concat([tf.repeat(seen[:, :, None], 2, axis=2), sides], axis=-1)
        found = self.load(tf.reshape(both, [-1, both.shape[-1]]), members)
        found = tf.reshape(found, [-1, b, k, 2, 5])
        gain = tf.exp(tf.clip_by_value(found[..., 4:], -GAIN_LIMIT, GAIN_LIMIT))
        unit = tf.constant([FORCE, FORCE, TORQUE, FORCE])
        # (11): each of the J strips bears its part of the width.
        share = kappa * width[:, None] / (WIDTH[self.tool.name] * count)
        shares, found = found, found[..., :4] * gain * unit * share[None, ..., None, None]
        if self.tool.bears:
            up = found[..., 1:2]
            # A wheel's other loads are shares of what it bears, which under a load is known.
            known = up if borne is None else borne[None, :, None, None, None] / count
            along, _, turn, side = tf.split(known * shares[..., :4], 4, axis=-1)
            found = tf.concat([along, up, self.tool.RIM * turn, side], axis=-1)
        # (12): a strip was asked once with each neighbour. In the plane both answers count the
        # same; across, those of the two sides push against each other.
        plane = tf.reduce_mean(found[..., :3], axis=3)  # of strips
        across = tf.reduce_sum(found[..., 0, 3] - found[..., 1, 3], axis=2)
        # z_j, middles of the strips about that of the tool.
        lever = (tf.range(count) - (count - 1.0) / 2.0) * width[:, None] / count
        along, up, turn = (plane[..., i] for i in range(3))
        sums = [
            tf.reduce_sum(along, axis=2), tf.reduce_sum(up, axis=2), across,
            -tf.reduce_sum(lever * up, axis=2), tf.reduce_sum(lever * along, axis=2),
            tf.reduce_sum(turn, axis=2),
        ]  # fmt: skip
        return tf.stack(sums, axis=-1)

    def loads(self, bins, scalars, members=None):
        """`load_of` frames."""
        width = 2.0 * scalars[:, 0, self.scalars['half_width']]
        return self.load_of(*self._seen('load_inputs', bins, scalars), width, members)

    def moved_of(self, name, seen, gate, members=None):
        """[M, ...] m by which 'surface' or 'soil' has moved, of its inputs [..., I] and of what
        outputs are multiplied by [...]: (14), (15)."""
        found = getattr(self, name)(tf.reshape(seen, [-1, seen.shape[-1]]), members)
        return LENGTH * gate[None] * tf.reshape(found, tf.concat([[-1], tf.shape(gate)], axis=0))

    def rise(self, bins, scalars, places, strips, members=None):
        """By how much the surface has risen, [M, B, P] m: (14).

        Args:
          bins, scalars: of `sweep.Frame`.
          places: [B, P, 2] u from the origin and distance across, m.
          strips: three pairs of `Strips.shares`, int32 and float32 [B, P], at the place, and
            `NEIGHBOUR` farther from and nearer to the middle.
          members: number of networks that answer; None: all.
        """
        found = self._seen('surface_inputs', bins, scalars, places, strips)
        return self.moved_of('surface', *found, members)

    def displacement(self, bins, scalars, places, strips, members=None):
        """By how much particles have moved, [M, B, P, 3] m along, up, across: (15); places are
        [B, P, 3] u from the origin, height over the level, distance across, m."""
        found = self._seen('soil_inputs', bins, scalars, places, strips)
        return self.moved_of('soil', *found, members)


def placed(strips: Strips, places):
    """Tensors that `rise` and `displacement` take as places and strips, of places [P, ...], m, of
    one frame."""
    across = places[None, :, -1]
    sign = np.where(across < 0, -1.0, 1.0)
    pairs = [strips.shares(across + d * sign) for d in (0.0, NEIGHBOUR, -NEIGHBOUR)]
    pairs = [(tf.constant(j, tf.int32), tf.constant(b, tf.float32)) for j, b in pairs]
    return tf.constant(places[None], tf.float32), pairs
