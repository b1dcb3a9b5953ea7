"""Tools of a soil field, their scale, and soils.

A field works in the units of a tool (Scale in docs/soil_field.md): lengths in `scale` m, forces in
rho g scale^3 of the standard soil, times in the root of scale over g. A blade's scale is 1 as long
as its width lies within those taught, else the factor that brings it there; a wheel's is its radius
over 0.1 m. `stress` is the logarithm of rho g scale.
"""

import abc
import dataclasses
import math
import numbers
from typing import ClassVar

import numpy as np

from learning_to_simulate.soil_field import payload, sweep
from pca_tools import files

STANDARD_DENSITY, STANDARD_GRAVITY = 1730.61, 9.81
# By how much a bucket's edge counts as blunter than it is, m of the field: plates were taught with
# radii of 13 to 18 mm, buckets with 4, and what lies between is neither.
BUCKET_EDGE = 0.01
# Of a usual bucket (`mpm.motions.operator_paths.bucket`): rise of its underside behind the edge,
# deg, and length of that as a share of its height. Most by which an underside falls, rad; lean up
# to which buckets of training have curled in the soil, rad.
FLOOR_DEG, FLOOR_SHARE, FLOOR_FALLS = 7.0, 0.6, math.radians(-60.0)
CURL = 0.42
LEAN = 0.1  # m of the field that a blade turns by with a change of lean of 1 rad


@dataclasses.dataclass(frozen=True)
class Soil:
    """Dry soil; ValueError for a value that no soil has.

    Attributes:
      friction_angle_deg: of the soil in itself.
      density: kg/m3, as packed.
      gravity: m/s2.
    """

    friction_angle_deg: float = 37.2348
    density: float = STANDARD_DENSITY
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self):
        _check(self, ('friction_angle_deg',), 'lie in (0, 90)', lambda value: 0 < value < 90)
        _check(self, ('density', 'gravity'))

    @property
    def friction(self) -> float:
        """Tangent of the friction angle."""
        return float(np.tan(np.radians(self.friction_angle_deg)))

    @property
    def weight(self) -> float:
        """rho g, in that of the standard soil."""
        return self.density * self.gravity / (STANDARD_DENSITY * STANDARD_GRAVITY)


@dataclasses.dataclass(frozen=True)
class Tool(abc.ABC):
    """What a field must know of a tool: its width across the way, and the radius of its lower edge
    or of its rim, m."""

    width: float
    radius: float

    name: ClassVar[str]
    columns: ClassVar[int]  # strips under the tool; 1: loads do not see neighbouring strips
    scalars: ClassVar[tuple[str, ...]]  # names of `values`
    bears: ClassVar[bool]  # whether its loads are shares of the force up
    # Of training, m of the field: least soil under the tool, least distance of a wall beside it,
    # largest cell of a map.
    least_soil: ClassVar[float]
    wall_beside: ClassVar[float]
    largest_cell: ClassVar[float]
    taught_turning: ClassVar[tuple[float, float]]  # see `Passage.turning`
    # Height over the soil, m of the field, from which on what it has moved stays.
    lifted: ClassVar[float]
    # Height over the terrain, m of the field, below which it levels its heap; 0: it does not.
    strikes: ClassVar[float]
    # Way back, m of the field, beyond which going back farther changes nothing.
    backs: ClassVar[float]
    # Way, m of the field, after which a passage is renewed where the tool cuts new soil.
    renewed_after: ClassVar[float]

    def __post_init__(self):
        _check(self, ('width', 'radius'))

    @property
    @abc.abstractmethod
    def scale(self) -> float:
        """m of the world to one m of the field."""

    def units(self, soil: Soil) -> np.ndarray:
        """[6] N (three times) and N m of the world to one of the field."""
        force = soil.weight * self.scale**3
        return np.array([force] * 3 + [force * self.scale] * 3)

    @abc.abstractmethod
    def turn(self, step) -> np.ndarray:
        """x of (7) of `sweep` [...], in lengths of the field, of changes [..., 3] of u, y (m of the
        field) and lean (rad)."""

    def leans(self, lean: float) -> float:
        """How far it leans (rad) on the side on which all taught ones do: a plate back, a bucket
        less than `CURL` back; 0 of a tool that rolls."""
        return 0.0

    def back(self, lean: float) -> tuple[float, float]:
        """Of its back, which rises behind its edge: the angle over the level (at most pi / 2) at
        a lean (rad), and its length, m of the field; a tool that rolls has none."""
        return 0.0, 0.0

    def room(self, lean: float, soil: Soil) -> payload.Room:
        """For soil that it holds at a lean (rad), in lengths of the field; none but a bucket has
        any."""
        return payload.Room()

    @abc.abstractmethod
    def values(self, soil: Soil) -> np.ndarray:
        """[S'] of `scalars`, in lengths of the field."""


@dataclasses.dataclass(frozen=True)
class Blade(Tool):
    """A blade or bucket; its pose is that of the middle of its lower edge.

    Attributes:
      radius: of the edge, m; of a bucket 0.004 was taught.
      length: height of the upright outline over the edge, m.
      bucket: 1 of a shell that is open to the front, 0 of a flat blade.
      plates: 1 where the ends of a bucket are closed.
      floor_deg: of a bucket that does not lean, by how much its underside rises behind the edge,
        degrees: from the edge to where that is least.
      floor_share: length of that underside as a share of `length`.
    """

    width: float = 0.457
    radius: float = 0.014
    length: float = 0.277
    bucket: float = 0.0
    plates: float = 0.0
    floor_deg: float = FLOOR_DEG
    floor_share: float = FLOOR_SHARE

    name = 'blade'
    columns = 5
    bears = False
    least_soil, wall_beside = 0.05, 0.07
    largest_cell, taught_turning = 0.04, (-0.55, 0.55)
    lifted = strikes = 0.04
    backs, renewed_after = sweep.FORGET, 0.6
    taught_widths: ClassVar = (0.15, 0.6)
    # `edge` is judged only: no network sees it.
    scalars = (
        'half_width', 'friction', 'radius', 'length', 'bucket', 'plates', 'floor', 'floor_share',
        'edge', 'stress',
    )  # fmt: skip

    def __post_init__(self):
        super().__post_init__()
        _check(self, ('length', 'floor_share'))
        _check(self, ('floor_deg',), 'lie in (-90, 90)', lambda value: -90 < value < 90)
        _check(self, ('bucket', 'plates'), 'be 0 or 1', lambda value: value in (0, 1))

    @property
    def scale(self):
        return self.width / float(np.clip(self.width, *self.taught_widths))

    def leans(self, lean):
        return CURL - lean if self.bucket else lean

    def back(self, lean):
        """See `Tool`: a plate; of a bucket the floor."""
        upright, share, least = np.pi / 2, 1.0, 0.0
        if self.bucket:
            upright, share, least = np.radians(self.floor_deg), self.floor_share, FLOOR_FALLS
        length = share * self.length - 2.0 * self.radius
        return float(np.clip(upright - lean, least, np.pi / 2)), max(length, 0.0) / self.scale

    def room(self, lean, soil):
        """See `Tool`, and `payload`."""
        return payload.room(self.shape, lean, soil.friction) if self.bucket else payload.Room()

    @property
    def shape(self) -> payload.Shape:
        """Of a bucket, in lengths of the field."""
        height = self.length / self.scale
        return payload.Shape(height, math.radians(self.floor_deg), self.floor_share * height)

    def turn(self, step):
        """See `Tool`: 0.1 m times the change of lean."""
        return LEAN * step[..., 2]

    def values(self, soil):
        s = self.scale
        floor = self.floor_deg, self.floor_share
        floor_deg, floor_share = floor if self.bucket else (FLOOR_DEG, FLOOR_SHARE)
        return np.array(
            [self.width / 2 / s, soil.friction, self.radius / s, self.length / s, self.bucket,
             self.plates, np.radians(floor_deg), floor_share,
             self.radius / s + BUCKET_EDGE * self.bucket, np.log(soil.weight * s)]
        )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Wheel(Tool):
    """A wheel. Its pose is that of the middle of its axle.

    Attributes:
      radius: of the rim between grousers, m.
      lugs, lug_height: number and height (m) of its grousers.
    """

    width: float = 1 / 12
    radius: float = 0.075
    lugs: int = 0
    lug_height: float = 0.0

    name = 'wheel'
    columns = 1
    bears = True
    least_soil, wall_beside = 0.008, 0.022
    largest_cell, taught_turning = 0.052, (-0.25, 0.85)
    lifted = 0.03
    strikes = 0.0
    backs = sweep.FAR  # it goes back without end, as it goes on
    renewed_after = np.inf  # its rut keeps its volume as it is
    RIM: ClassVar = 0.1  # m of the field
    scalars = ('half_width', 'friction', 'radius', 'lugs', 'lug_height', 'stress')

    def __post_init__(self):
        super().__post_init__()
        _check(self, ('lugs', 'lug_height'), 'not be negative', lambda value: 0 <= value < np.inf)

    @property
    def scale(self):
        return self.radius / self.RIM

    def turn(self, step):
        """See `Tool`: the slip of the rim, positive where it spins; a wheel that rolls forward
        leans forward, so R dalpha is -R dlean."""
        return -self.RIM * step[..., 2] - step[..., 0]

    def values(self, soil):
        s = self.scale
        return np.array(
            [self.width / 2 / s, soil.friction, self.RIM, float(self.lugs), self.lug_height / s,
             np.log(soil.weight * s)]
        )  # fmt: skip


TOOLS = {tool.name: tool for tool in (Blade, Wheel)}


def read_tool(path: str) -> Tool:
    """The tool of a JSON file of `lts new-tool` and the solver (`mpm/README.md`): a plate, a bucket
    or a wheel, lengths in m. What a model has no input for, such as its friction, is passed over.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: it describes no tool.
    """
    described = files.read_json(path)
    try:
        return tool_as(described)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(
            f'{path} is not a tool: {type(error).__name__} {error}; mpm/README.md says what is'
        ) from error


def tool_as(described: dict) -> Tool:
    """The tool of such a description. Of an outline its underside is the line from its edge, the
    origin, to the point behind by which it rises least."""
    width = float(described['width'])
    if 'radius' in described:
        lugs = described.get('grousers') or {}
        lugs = int(lugs.get('count', 0)), float(lugs.get('height', 0.0))
        return Wheel(width, float(described['radius']), *lugs)
    radius, (x, y) = float(described['edge_radius']), np.array(described['outline'], float).T
    plates = float('side_plates' in described)
    rise = np.where(x > radius, np.arctan2(y, x), np.inf)
    k = int(np.argmin(rise))
    # Two points are a plate, all else that was taught is a bucket.
    shape = width, radius, float(np.ptp(y)), float(len(x) > 2), plates
    if len(x) == 2 or not np.isfinite(rise[k]):
        return Blade(*shape)
    return Blade(*shape, float(np.degrees(rise[k])), float(np.hypot(x[k], y[k]) / np.ptp(y)))


def _check(owner, names, must='be positive', is_right=lambda value: 0 < value < np.inf):
    for name in names:
        value = getattr(owner, name)
        if not (isinstance(value, numbers.Real) and is_right(value)):
            raise ValueError(f'{type(owner).__name__}.{name} must {must}, got {value!r}')
