"""Names beside the points of a picture, placed where they cover nothing."""

from matplotlib.transforms import Bbox

# Where a label may stand: (horizontal, vertical, alignment) from the point, nearest first, pixels.
_SIDES = (
    (1, 0, 'left'), (-1, 0, 'right'), (0, 1, 'center'), (0, -1, 'center'), (1, 1, 'left'),
    (1, -1, 'left'), (-1, 1, 'right'), (-1, -1, 'right'),
)  # fmt: skip
_DISTANCES = (9, 16, 26, 40, 58)
_MARKER = 6


def place(figure, axes, places: dict[str, tuple[float, float]], fontsize: float = 8) -> None:
    """Writes each label beside its point, clear of the points, of earlier labels and of the frame.

    Args:
      figure: its layout is fixed here: nothing may move afterwards.
      axes: where the points are.
      places: label -> (x, y) in data units.
      fontsize: of the labels.
    """
    figure.draw_without_rendering()
    figure.set_layout_engine('none')
    renderer = figure.canvas.get_renderer()
    points = {name: axes.transData.transform(p) for name, p in places.items()}
    taken = [
        Bbox.from_bounds(x - _MARKER, y - _MARKER, 2 * _MARKER, 2 * _MARKER)
        for x, y in points.values()
    ]
    taken += [t.get_window_extent(renderer) for t in axes.texts]
    frame = axes.get_window_extent(renderer)
    # Upper points first: there is more room above them.
    for name in sorted(points, key=lambda n: -points[n][1]):
        best = None
        for dx, dy, align, distance in _candidates():
            text = axes.annotate(
                name, points[name], (points[name][0] + dx * distance, points[name][1] + dy * distance),
                xycoords='figure pixels', textcoords='figure pixels', fontsize=fontsize,
                ha=align, va='center', color='0.15',
            )  # fmt: skip
            box = text.get_window_extent(renderer)
            cost = sum(_overlap(box, other) for other in taken)
            cost += 10 * (box.width * box.height - _overlap(box, frame)) + 0.02 * distance
            if best is None or cost < best[0]:
                if best:
                    best[1].remove()
                best = (cost, text, box, distance)
            else:
                text.remove()
        taken.append(best[2])
        if best[3] > _DISTANCES[1]:
            x, y = best[1].get_position()
            best[1].remove()
            axes.annotate(
                name, points[name], (x, y), xycoords='figure pixels', textcoords='figure pixels',
                fontsize=fontsize, ha=best[1].get_ha(), va='center', color='0.15',
                arrowprops={'arrowstyle': '-', 'color': '0.6', 'linewidth': 0.6, 'shrinkB': 4},
            )  # fmt: skip


def _candidates():
    for distance in _DISTANCES:
        for dx, dy, align in _SIDES:
            yield dx, dy, align, distance


def _overlap(a: Bbox, b: Bbox) -> float:
    width = min(a.x1, b.x1) - max(a.x0, b.x0)
    height = min(a.y1, b.y1) - max(a.y0, b.y0)
    return max(width, 0.0) * max(height, 0.0)
