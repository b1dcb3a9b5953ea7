"""One view of soil and body: particles by colour, the outline of the body, the force on it.

The artists of a view are made once and moved from frame to frame, which is what makes a movie of a
hundred frames a matter of seconds.
"""

import dataclasses

import numpy as np
from matplotlib import colors
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.patches import Polygon
from matplotlib.quiver import Quiver
from scipy import spatial

from learning_to_simulate.rendering.rollout_frames import PLANES, PREDICTION, RolloutFrames

# Steps too small to see, but soil that hardly moves keeps its exact colour: a GIF of it is smaller.
_COLOR_STEPS = 40
# Soil at rest (or predicted without error) is sand; the lightness falls steadily over both maps.
COLOR_MAPS = {
    'speed': colors.LinearSegmentedColormap.from_list(
        'speed', ['#e9dfc7', '#f2b75f', '#e5733d', '#bf3654', '#7b1f6b', '#2d1150'], N=_COLOR_STEPS
    ),
    'error': colors.LinearSegmentedColormap.from_list(
        'error', ['#e9dfc7', '#b5cdbf', '#6fb0b8', '#3b84ad', '#2c4f94', '#1c1f5a'], N=_COLOR_STEPS
    ),
}
BODY_FACE, BODY_EDGE = '#8fa3b3', '#22303c'
FORCE_COLOR = '#0b6e99'
PLAIN_SOIL = '#d3c19a'
# The particles nearest to the middle plane show the cut; more of them only blur it.
_SIDE_VIEW_SHARE, _SIDE_VIEW_LEAST = 0.31, 300
# Share of the particles' speeds (or errors) that the colours resolve; the fastest few saturate.
_COLOR_QUANTILE = 0.995
_COLOR_SAMPLES = 40
_ARROW_SHARE = 0.3
# Markers wider than the particles lie apart, so that the bed looks filled; those of a thin sample
# would hide one another.
_MARKER_OVERLAP, _THIN_OVERLAP, _THIN = 1.7, 1.2, 1000
_MARGIN = 0.03
# A shallow bed gets air above it, so that labels find room.
_LEAST_ASPECT = 0.45
# Of the force key above the view, in points: the height of a title.
_KEY_HEIGHT = 11.0
_ROUND_BODY_TOLERANCE = 0.02
_FLAT_BODY_TOLERANCE = 1e-3
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 73)


@dataclasses.dataclass(frozen=True)
class ViewSetup:
    """What the views of one rollout share, so that truth and prediction can be compared.

    Attributes:
        plane: indices of the horizontal and the vertical axis.
        particles: int [P], the soil particles drawn, in no order.
        limits: float64 [2, 2], low and high end of both axes, m.
        vmax: {speed: mm/s, error: mm}, upper end of the colours.
        newtons_per_metre: scale of the force arrow.
        key_force: N, length of the arrow that explains the scale.
        spacing: m, typical distance of the drawn particles in the picture.
    """

    plane: tuple[int, int]
    particles: np.ndarray
    limits: np.ndarray
    vmax: dict[str, float]
    newtons_per_metre: float
    key_force: float
    spacing: float

    @property
    def aspect(self) -> float:
        """Height over width."""
        width, height = self.limits[:, 1] - self.limits[:, 0]
        return float(height / width)


def setup(frames: RolloutFrames, plane: str | None, drawn: np.ndarray) -> ViewSetup:
    """Chooses particles, limits and scales for the shown frames int [F'] that will be drawn.

    They follow from the truth where there is one, so that a poor prediction does not change them.
    The plane is a key of `rollout_frames.PLANES`; None for the view from the side.
    """
    axes, which = PLANES[plane or frames.side_view], frames.reference
    body = frames.rigid[which][frames.frames[drawn]][..., axes]
    points = body.reshape(-1, 2)
    vmax = {'speed': 1.0, 'error': 1.0}
    particles, spacing = np.zeros(0, int), 0.01
    if frames.soil:
        particles = _chosen_particles(frames, axes)
        sample = drawn[np.linspace(0, len(drawn) - 1, _COLOR_SAMPLES).astype(int)]
        shown = {'speed': [frames.soil_velocity(which, i)[particles] for i in sample]}
        if frames.has_truth:
            shown['error'] = [frames.soil_error(i)[particles] for i in sample]
        for name, vectors in shown.items():
            sizes = np.linalg.norm(vectors, axis=-1)
            vmax[name] = _round_up(1e3 * float(np.quantile(sizes, _COLOR_QUANTILE)))
        soil = frames.soil[which][sample][:, particles][..., axes].reshape(-1, 2)
        spacing = float(np.sqrt(np.prod(np.ptp(soil, axis=0)) / len(particles)))
        points = np.concatenate([points, soil])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _MARGIN * np.max(high - low)
    limits = np.stack([low - margin, high + margin], axis=1)
    limits[1, 1] = max(limits[1, 1], limits[1, 0] + _LEAST_ASPECT * np.ptp(limits[0]))
    strongest = 1.0
    if frames.force is not None:
        force = frames.force[which][frames.frames[drawn]][:, axes]
        strongest = float(np.linalg.norm(force, axis=-1).max()) or 1.0
    length = _ARROW_SHARE * float(np.min(limits[:, 1] - limits[:, 0]))
    return ViewSetup(
        axes, particles, limits, vmax, strongest / length, _round_up(strongest / 3), spacing
    )


def _chosen_particles(frames: RolloutFrames, axes: tuple[int, int]) -> np.ndarray:
    """Side view: those nearest to the middle plane of the body; other views: all."""
    start = frames.start
    if axes != PLANES[frames.side_view]:
        return np.arange(len(start))
    count = max(_SIDE_VIEW_SHARE * len(start), min(len(start), _SIDE_VIEW_LEAST))
    body = frames.rigid[frames.reference][0]
    depth = 3 - sum(axes)
    middle = (body if len(body) else start)[:, depth].mean()
    return np.argsort(np.abs(start[:, depth] - middle), kind='stable')[: int(count)]


def _round_up(value: float) -> float:
    """The next of 1, 1.5, 2, 3, 4, 5, 6, 8 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value)) if value > 0 else 1.0
    return float(next(s for s in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if s * power >= value) * power)


class ParticleView:
    """Axes with the soil, the body and the force of `which`, truth or prediction.

    In colours of the error the truth, which has none, is drawn in one colour; `show_key` explains
    the scale of the force arrow.
    """

    def __init__(
        self, axes: Axes, frames: RolloutFrames, which: str, view: ViewSetup, color_by: str,
        show_key: bool,
    ):  # fmt: skip
        self._frames, self._which, self._view = frames, which, view
        self._color_by = color_by if which == PREDICTION or color_by == 'speed' else None
        axes.set(xlim=view.limits[0], ylim=view.limits[1], aspect='equal')
        axes.update_datalim(view.limits.T)  # the arrow takes its scale from the data limits
        width = 72.0 * axes.get_position().width * axes.figure.get_figwidth()
        self._points_per_metre = width / float(np.ptp(view.limits[0]))
        self.soil = self._add_soil(axes)
        self._is_round, self._hull = self._body_shape()
        self.body = Polygon(
            np.zeros((2, 2)), closed=True, facecolor=BODY_FACE, edgecolor=BODY_EDGE,
            linewidth=3.0, joinstyle='round', capstyle='round', alpha=0.9, zorder=3,
        )  # fmt: skip
        self.spokes = LineCollection([], colors=BODY_EDGE, linewidths=0.8, alpha=0.7, zorder=4)
        self.arrow = self._add_arrow(axes, show_key)
        axes.add_patch(self.body)
        axes.add_collection(self.spokes, autolim=False)

    @property
    def artists(self) -> list:
        moving = [self.soil, self.body, self.spokes, self.arrow]
        return [artist for artist in moving if artist is not None]

    def update(self, i: int) -> None:
        frame = self._frames.frames[i]
        if self.soil is not None:
            self._update_soil(i)
        points = self._frames.rigid[self._which][frame][:, self._view.plane]
        if not len(points):
            return
        centre = points.mean(axis=0)
        if self._is_round:
            radius = np.linalg.norm(points - centre, axis=1).mean()
            outline = centre + radius * np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)], axis=1)
            self.spokes.set_segments([(centre, point) for point in points])
        else:
            outline = points[self._hull]
        self.body.set_xy(outline)
        if self.arrow is not None:
            force = self._frames.force[self._which][frame][list(self._view.plane)]
            self.arrow.set_offsets(centre)
            self.arrow.set_UVC(*(component[None] for component in force))

    def _add_soil(self, axes: Axes) -> PathCollection | None:
        view = self._view
        if not len(view.particles):
            return None
        overlap = _THIN_OVERLAP if len(view.particles) < _THIN else _MARKER_OVERLAP
        style = {'s': (overlap * view.spacing * self._points_per_metre) ** 2, 'linewidths': 0}
        if self._color_by is None:
            return axes.scatter([], [], color=PLAIN_SOIL, **style)
        return axes.scatter(
            [], [], c=[], cmap=COLOR_MAPS[self._color_by], vmin=0.0,
            vmax=view.vmax[self._color_by], **style,
        )  # fmt: skip

    def _update_soil(self, i: int) -> None:
        frames, chosen, plane = self._frames, self._view.particles, self._view.plane
        position = frames.soil[self._which][i][chosen]
        # Seen from the other side of the third axis: what is nearer is drawn later.
        order = np.argsort(position[:, 3 - sum(plane)], kind='stable')
        self.soil.set_offsets(position[order][:, plane])
        if self._color_by is None:
            return
        is_speed = self._color_by == 'speed'
        vectors = frames.soil_velocity(self._which, i) if is_speed else frames.soil_error(i)
        self.soil.set_array(1e3 * np.linalg.norm(vectors[chosen][order], axis=1))

    def _body_shape(self) -> tuple[bool, np.ndarray]:
        """Whether the points lie on a circle in this plane; else the indices of their hull."""
        points = self._frames.rigid[self._frames.reference][0][:, self._view.plane]
        if not len(points):
            return False, np.zeros(0, int)
        centred = points - points.mean(axis=0)
        distance = np.linalg.norm(centred, axis=1)
        _, spread, directions = np.linalg.svd(centred, full_matrices=False)
        if len(points) < 3 or spread[1] <= _FLAT_BODY_TOLERANCE * spread[0]:
            along = centred @ directions[0]
            return False, np.array([np.argmin(along), np.argmax(along)])
        is_round = len(points) > 4 and np.ptp(distance) <= _ROUND_BODY_TOLERANCE * distance.mean()
        return bool(is_round), spatial.ConvexHull(points).vertices

    def _add_arrow(self, axes: Axes, show_key: bool) -> Quiver | None:
        view = self._view
        if self._frames.force is None or not self._frames.rigid[self._frames.reference].shape[1]:
            return None
        style = {
            'angles': 'xy', 'scale_units': 'xy', 'scale': view.newtons_per_metre, 'width': 0.01,
            'headwidth': 3.4, 'headlength': 3.8, 'headaxislength': 3.4, 'color': FORCE_COLOR,
            'edgecolor': 'white', 'linewidth': 0.6, 'zorder': 5,
        }  # fmt: skip
        if show_key:
            right, high = view.limits[:, 1]
            length = view.key_force / view.newtons_per_metre
            # Beside the title: above the view there is never any soil.
            height = _KEY_HEIGHT / self._points_per_metre
            x, y = right - length, high + height
            axes.quiver([x], [y], [view.key_force], [0.0], clip_on=False, **style)
            axes.text(
                x - 0.4 * height, y, f'force {view.key_force:g} N', fontsize=8,
                color=FORCE_COLOR, ha='right', va='center',
            )  # fmt: skip
        return axes.quiver([0.0], [0.0], [0.0], [0.0], **style)
