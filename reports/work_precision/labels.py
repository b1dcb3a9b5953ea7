"""Names beside the points of a picture, placed where they cover nothing."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.transforms import Bbox

# Where a label may stand from its point: (right, up, alignment), and how far, in points.
_SIDES = (
    (1, 0, 'left'), (-1, 0, 'right'), (0, 1, 'center'), (0, -1, 'center'), (0.8, 0.8, 'left'),
    (0.8, -0.8, 'left'), (-0.8, 0.8, 'right'), (-0.8, -0.8, 'right'),
)  # fmt: skip
_DISTANCES = (8, 13, 20, 30, 44)
_LINE_FROM = 16  # A label farther away than this is tied to its point by a thin line.
_MARKER, _LINE = 9, 3  # Pixels that a marker and a piece of a line keep clear.


def place(axes, places: dict[str, tuple[float, float]], fontsize: float = 8) -> None:
    """Writes each label beside its point, clear of points, lines, earlier labels and the frame.

    The layout of the figure is fixed here: nothing may move afterwards.

    Args:
      axes: where the points are.
      places: label -> (x, y) in data units.
      fontsize: of the labels.
    """
    figure = axes.get_figure()
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw_without_rendering()
    figure.set_layout_engine('none')
    pixels = {name: axes.transData.transform(p) for name, p in places.items()}
    taken = [(_around(p, _MARKER), 3.0) for p in pixels.values()]
    taken += [(_around(p, _LINE), 1.0) for line in axes.lines for p in _along(line)]
    taken += [(text.get_window_extent(renderer), 3.0) for text in axes.texts]
    frame = axes.get_window_extent(renderer)
    # Upper points first: there is more room above them.
    for name in sorted(pixels, key=lambda n: -pixels[n][1]):
        best = None
        for right, up, align, distance in _candidates():
            text = axes.annotate(
                name, places[name], (right * distance, up * distance), textcoords='offset points',
                fontsize=fontsize, ha=align, va='center', color='0.1',
                arrowprops={'arrowstyle': '-', 'color': '0.55', 'linewidth': 0.7, 'shrinkA': 0,
                            'shrinkB': 4} if distance > _LINE_FROM else None,
            )  # fmt: skip
            text.update_positions(renderer)
            # Annotation's own extent includes its line, which may cross things.
            box = super(type(text), text).get_window_extent(renderer)
            cost = sum(weight * _overlap(box, other) for other, weight in taken)
            cost += 10 * (box.width * box.height - _overlap(box, frame)) + distance
            if best is None or cost < best[0]:
                if best:
                    best[1].remove()
                best = (cost, text, box)
            else:
                text.remove()
        if best:
            taken.append((best[2], 3.0))


def _candidates():
    for distance in _DISTANCES:
        for right, up, align in _SIDES:
            yield right, up, align, distance


def _around(point, width):
    return Bbox.from_bounds(point[0] - width / 2, point[1] - width / 2, width, width)


def _along(line):
    """Points every few pixels along a drawn line."""
    corners = line.get_transform().transform(line.get_xydata())
    for start, end in zip(corners[:-1], corners[1:], strict=True):
        count = int(np.hypot(*(end - start)) / (2 * _LINE)) + 1
        yield from start + np.linspace(0, 1, count)[:, None] * (end - start)


def _overlap(a: Bbox, b: Bbox) -> float:
    width = min(a.x1, b.x1) - max(a.x0, b.x0)
    height = min(a.y1, b.y1) - max(a.y0, b.y0)
    return max(width, 0.0) * max(height, 0.0)
