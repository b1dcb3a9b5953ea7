"""`SoilField`: trained networks of one kind of tool, what they were taught, and their folder.

A model folder holds `config.json` and `weights.npz`.
"""

import dataclasses
import os

import numpy as np
import tensorflow as tf

from learning_to_simulate import checkpoints, error_bound
from learning_to_simulate.rollout_status import Ranges
from learning_to_simulate.scene import is_int, require
from learning_to_simulate.soil_field import network, sweep
from learning_to_simulate.soil_field.passage import AHEAD, Passage
from learning_to_simulate.soil_field.settings import SoilFieldConfig
from learning_to_simulate.soil_field.tools import TOOLS
from pca_tools import files

# Share of its training range by which a number may leave it.
MARGIN = 0.05
WIDEST = 1024  # units of a layer of a file, which are drawn before its weights replace them
# What no network sees; beyond these limits a frame in the soil is flagged: name -> (least, most).
# Yaw and roll, rad; all others in m of the field: distance of the tool from the plane of its
# passage; how far its ends stand out of the map; what is missing of the tool's `least_soil` between
# it and the floor; by how much another tool is nearer than `APART`; the side of a cell, at most the
# tool's `largest_cell`; `Passage.crossfall`; of no unit, `Passage.slope` and `turning`, in the
# tool's `taught_turning`; rad, `Tool.leans`; m of the field, by how much a wall is nearer to
# its ends than the tool's `wall_beside`; m2 of the field, `Passage.heel`.
CONDITIONS = {
    'yaw': (-0.035, 0.035),
    'roll': (-0.035, 0.035),
    'aside': (-0.02, 0.02),
    'beyond_map': (0.0, 0.02),
    'thin_soil': (0.0, 0.0),
    'other_tool': (0.0, 0.0),
    'cell': (0.0, np.nan),
    'crossfall': (0.0, 0.004),
    'slope': (-0.09, 0.09),
    'turning': (np.nan, np.nan),
    'leans': (-0.05, np.pi),
    'wall_beside': (0.0, 0.0),
    'heel': (0.0, 1e-4),
}
APART = 0.1
# What a reason names, in words for a user, and its unit (lengths are of the field).
WORDS = {
    'lean': ('lean of the tool', 'rad'),
    'area': ('soil cut by the tool', 'm²'),
    'carried': ('soil pushed along by the tool', 'm²'),
    'speed': ('speed of the tool', 'm/s'),
    'pressed': ('soil pressed down by the back of the tool', 'm²'),
    'half_width': ('half the width of the tool', 'm'),
    'friction': ('friction of the soil', ''),
    'radius': ('radius of the tool', 'm'),
    'length': ('length of the tool', 'm'),
    'bucket': ('being a bucket', ''),
    'plates': ('side plates of the bucket', ''),
    'floor': ('rise of the underside of the bucket', 'rad'),
    'floor_share': ('length of the underside of the bucket, in heights of it', ''),
    'edge': ('radius of the edge', 'm'),
    'lugs': ('number of grousers', ''),
    'lug_height': ('height of the grousers', 'm'),
    'stress': ('weight of the soil for a tool of this size, logarithm', ''),
    'depth': ('depth of the tool in the soil', 'm'),
    'bed_low': ('lowest soil near the tool, above that under it', 'm'),
    'bed_high': ('highest soil near the tool, above that under it', 'm'),
    'uneven': ('unevenness of the soil across the tool', 'm'),
    'wall': ('nearness of a wall ahead', 'm'),
    'along': ('speed of the tool along the ground', 'm/s'),
    'backed': ('way back in the soil', 'm'),
    'wall_behind': ('nearness of a wall behind', 'm'),
    'yaw': ('turn of the tool away from its line', 'rad'),
    'roll': ('roll of the tool to one side', 'rad'),
    'aside': ('distance of the tool from its line', 'm'),
    'beyond_map': ('part of the tool beyond the terrain', 'm'),
    'thin_soil': ('soil missing between the tool and the floor', 'm'),
    'other_tool': ('nearness of another tool', 'm'),
    'cell': ('side of a cell of the terrain', 'm'),
    'crossfall': ('fall of the ground across the tool', 'm'),
    'slope': ('slope of the ground along the way', ''),
    'turning': ('turn or slip of the tool on its way', ''),
    'leans': ('lean of the tool against its cut', 'rad'),
    'wall_beside': ('nearness of a wall beside', 'm'),
    'heel': ('soil pressed down by the heel of a bucket that curls', 'm²'),
}
# Numbers of a frame that are judged: scalars, and what follows from bins about the tool, from how
# near walls are, and from how far the tool has gone back in the soil.
_SCALARS = ('lean', 'area', 'carried', 'speed', 'pressed')
_OF_BINS = (
    'depth', 'bed_low', 'bed_high', 'uneven', 'wall', 'along', 'backed', 'wall_behind',
)  # fmt: skip
OF_SOIL = 'friction', 'stress'  # scalars
# Of the ground: it is as in training where it differs by less than so much, m of the field.
_OF_GROUND, SMOOTH = ('bed_low', 'bed_high', 'uneven'), 0.0005
# Bins so far from the tool tell of the ground under it and about it, m of the field.
HERE, NEAR = 0.05, 0.25


@dataclasses.dataclass
class SoilField:
    """A trained model.

    Attributes:
      config: how it was trained.
      networks: of it.
      ranges: name of a number of `judged` -> its range in training.
      bounds: what `evaluation.bounds_of` found on valid runs: `force`, the weights [3] of
        `error_bound.bound` in N of the field; `near_mm`, of `near_95_mm` of `evaluation`. {} where
        nothing was found.
      data: where its training data came from, for the record.
    """

    config: SoilFieldConfig
    networks: network.SoilNetworks
    ranges: dict[str, list[float]] = dataclasses.field(default_factory=dict)
    bounds: dict = dataclasses.field(default_factory=dict)
    data: dict = dataclasses.field(default_factory=dict)

    @property
    def judged_names(self) -> tuple[str, ...]:
        """Of the columns of `judged`."""
        return (*_SCALARS, *self.networks.tool.scalars, *_OF_BINS, *CONDITIONS)

    @property
    def limits(self) -> Ranges:
        names = self.judged_names
        known = self._known
        low, high = np.array([known[name] for name in names], float).T
        extra = np.where([n in CONDITIONS for n in names], 0.0, MARGIN * (high - low)) + 1e-6
        extra = np.maximum(extra, np.where([n in _OF_GROUND for n in names], SMOOTH, 0.0))
        return Ranges(names, low, high, np.stack([low - extra, high + extra]))

    @property
    def middle(self) -> np.ndarray:
        known = self._known
        return np.array([np.mean(known.get(name, (0, 0))) for name in self.judged_names])

    @property
    def _known(self):
        tool = self.networks.tool
        of_tool = {'cell': (0.0, tool.largest_cell), 'turning': tool.taught_turning}
        return self.ranges | CONDITIONS | of_tool

    def judged(
        self, frames: sweep.Frame, conditions=None, bears: bool | None = None, holds: bool = False
    ) -> np.ndarray:
        """[T, N] numbers that say whether frames of one tool are like those of training, see
        `judged_names`; `conditions` are [T, C] of `CONDITIONS` (None: all as they should be),
        `bears` says whether soil acts on the tool, where that is known, see `contact`; `holds`
        whether it holds soil, which runs out by lean and roll."""
        columns = self.networks.scalars

        def first(name):
            return frames.scalars[:, 0, columns[name]]

        tip, backs = first('tip'), self.networks.tool.backs
        surface = frames.bins[..., sweep.SURFACE]
        places = sweep.OFFSETS - tip[:, None]
        here = np.abs(places)[:, None] < HERE
        near = np.abs(places)[:, None] < NEAR
        under = surface.mean(axis=1, keepdims=True)
        level = np.where(here, under, 0.0).sum(axis=(1, 2)) / here.sum(axis=(1, 2))
        found = [
            level - (first('height') - first('radius')),
            np.where(near, surface, np.inf).min(axis=(1, 2)) - level,
            np.where(near, surface, -np.inf).max(axis=(1, 2)) - level,
            np.where(near, np.abs(surface - under), 0.0).max(axis=(1, 2)),
            AHEAD - first('ahead').astype(np.float64),
            # A tool that falls is faster than any that goes on.
            np.abs(first('along_0').astype(np.float64)) * first('speed'),
            np.clip(frames.scalars[..., columns['foremost']].max(axis=1) - tip, 0.0, backs),
            AHEAD - first('behind').astype(np.float64),
        ]
        names = self.judged_names[: named(self.networks.tool)]
        own = [frames.scalars[..., columns[n]].max(axis=1) for n in names]
        values = np.stack(own + found, axis=1).astype(np.float64)
        # In the air all is free but what the tool is.
        touches = self._lowest_part(frames) < level + network.ABOVE + (
            network.HEAP * np.sqrt(np.maximum(values[:, 1:3].max(axis=1), 0.0))
        )
        if bears is not None:
            touches[:] = bears
        free = np.zeros(len(self.judged_names), bool)
        free[: len(_SCALARS)] = free[len(names) :] = True
        free[[self.judged_names.index(name) for name in ('lean', 'roll')]] = not holds
        if conditions is None:
            conditions = np.zeros((len(values), len(CONDITIONS)))
        values = np.concatenate([values, np.asarray(conditions, np.float64)], axis=1)
        return np.where(free & ~touches[:, None], self.middle, values)

    def _lowest_part(self, frames):
        """Height of the lowest part of a tool [T]; a blade on its head hangs below its edge."""
        columns = self.networks.scalars
        height, radius = (frames.scalars[:, 0, columns[n]] for n in ('height', 'radius'))
        if 'length' not in columns:
            return height - radius
        lean, length = (frames.scalars[:, 0, columns[n]] for n in ('lean', 'length'))
        return height - radius + np.minimum(length * np.cos(lean), 0.0)

    def contact(self, passage: Passage, members: int | None = None) -> float:
        """Share of the load that acts on the tool of a passage, (22). kappa of the load knows how
        high a heap can be; this asks how high soil stands."""
        frame, columns = passage.frame, self.networks.scalars
        tip, half = (float(frame.scalars[0, 0, columns[n]]) for n in ('tip', 'half_width'))
        surface = frame.bins[0, passage.strips.under, :, sweep.SURFACE]
        near = np.abs(sweep.OFFSETS - tip) < network.UNDER_ALONG[-1]
        clearance = float(self._lowest_part(frame)[0]) - float(surface[:, near].max())
        if clearance <= network.ABOVE:
            return 1.0
        places = np.stack(
            np.meshgrid(
                tip + np.array(network.UNDER_ALONG), half * np.array(network.UNDER_ACROSS),
                indexing='ij',
            ), axis=-1,
        )  # fmt: skip
        risen = max(float(self.rise(passage, places.reshape(-1, 2), members).max()), 0.0)
        return float(np.clip((network.ABOVE - clearance + risen) / network.RAMP + 1.0, 0.0, 1.0))

    def bound(self, force, spread, unit: float, members: int | None = None) -> float:
        """What the length of the error of a force keeps, N: in 95 % of the frames of 9 of 10 runs
        that are like those of training; of force and spread [3], N, and what is one N of the field.
        NaN where it is not known, as where not all members have answered."""
        if 'force' not in self.bounds or members not in (None, self.networks.members):
            return float('nan')
        signs = np.linalg.norm(spread) / unit, np.linalg.norm(force) / unit
        return float(unit * error_bound.bound(*signs, self.bounds['force']))

    def rise(self, passage: Passage, places, members: int | None = None) -> np.ndarray:
        """How far the surface has risen [K] at places [K, 2] of a passage, m of the field."""
        return self._of_places('rise', passage, places, members)

    def loads(self, frame: sweep.Frame, members: int | None = None) -> np.ndarray:
        """float32 [M, B, 6] of frames, see `SoilNetworks.load_of`."""
        call = self.networks.compiled('loads', frame.bins.shape[1], members)
        return call(*map(tf.constant, self._within(frame))).numpy()

    def displacement(self, passage: Passage, places, members: int | None = None) -> np.ndarray:
        """How far particles have moved [P, 3] since a passage began, along, up, across, from places
        [P, 3] u from the origin, height over the level, across; all in m of the field."""
        return self._of_places('displacement', passage, places, members)

    def _of_places(self, name, passage, places, members):
        call = self.networks.compiled(name, len(passage.strips.centres), members)
        frame = map(tf.constant, self._within(passage.frame))
        return call(*frame, *network.placed(passage.strips, places)).numpy().mean(axis=0)[0]

    def _within(self, frame: sweep.Frame) -> sweep.Frame:
        """What networks see of frames: a soil farther from those that were taught than half of
        their range is as the nearest one that is not, and a tool that is faster than any feels what
        the fastest did. Both are flagged."""
        scalars = frame.scalars.copy()
        known = {name: self.ranges[name] for name in OF_SOIL if name in self.ranges}
        limits = {
            name: (low - (high - low) / 2, high + (high - low) / 2)
            for name, (low, high) in known.items()
        }
        fastest = self.ranges.get('speed', [0.0, np.inf])[1]
        paces = (f'pace_{i}' for i in range(len(sweep.MEMORIES)))
        limits |= dict.fromkeys(('speed', *paces), (0.0, fastest))
        for name, (low, high) in limits.items():
            column = scalars[..., self.networks.scalars[name]]
            np.clip(column, low, high, out=column)
        return sweep.Frame(frame.bins, scalars)


def named(tool) -> int:
    """How many of the numbers that are judged are scalars of a frame; they come first."""
    return len(_SCALARS) + len(tool.scalars)


def save(path: str, field: SoilField) -> None:
    """Writes a model folder, config.json last: it says that the rest is there. ValueError for
    weights that are not finite: nothing is written."""
    checkpoints.save_weights(path, _weights(field.networks))
    files.write_json(
        os.path.join(path, checkpoints.CONFIG_FILE),
        {
            'schema_version': checkpoints.SCHEMA_VERSION,
            'config': dataclasses.asdict(field.config),
            'field': {
                'tool': field.networks.tool.name,
                'hidden': field.networks.hidden,
                'ranges': field.ranges,
                'bounds': field.bounds,
            },
            'data': field.data,
        },
    )


def load(path: str) -> SoilField:
    """Reads a model folder; FileNotFoundError: no model there; ValueError: a damaged one, or one of
    another method."""
    stored = checkpoints.read_config(path)
    with checkpoints.refusing_wrong_fields(path):
        config = SoilFieldConfig(**stored['config'])
        values = stored['field']
        tool = TOOLS[values['tool']]
        ranges = {str(k): [float(x) for x in v] for k, v in values['ranges'].items()}
        hidden = {k: tuple(values['hidden'][k]) for k in network.NETWORKS}
        are_sizes = all(is_int(n, 1, WIDEST) for layers in hidden.values() for n in layers)
        require(are_sizes, 'hidden', hidden)
        bounds = _bounds(values.get('bounds', {}))

    def make():
        return network.SoilNetworks(tool, config.members, config.seed, hidden)

    networks = checkpoints.filled(path, make, _weights)
    found = SoilField(config, networks, ranges, bounds, stored.get('data', {}))
    with checkpoints.refusing_wrong_fields(path):
        _ = found.limits
    return found


def _bounds(stored):
    """Bounds of a folder; raises what `refusing_wrong_fields` takes."""
    if not stored:
        return {}
    found = {'force': [float(x) for x in stored['force']], 'near_mm': float(stored['near_mm'])}
    numbers = np.array([*found['force'], found['near_mm']])
    if len(found['force']) != 3 or not (np.isfinite(numbers).all() and (numbers >= 0).all()):
        raise ValueError(f'bounds are {stored}: three weights and a length, not negative')
    return found


def _weights(networks) -> dict:
    return {
        f'{name}/{i}/{kind}': variable
        for name in network.NETWORKS
        for i, layer in enumerate(getattr(networks, name).layers)
        for kind, variable in zip(('weight', 'bias'), layer, strict=True)
    }
