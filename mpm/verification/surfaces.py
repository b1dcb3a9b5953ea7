"""The height of a bed of soil, continuous in the places of its particles."""

import numpy as np

from mpm import scenes

SIDE = 0.027  # m, of the squares, about; two spacings of the particles of the excavation


def surface(positions: np.ndarray, box: scenes.Bin) -> np.ndarray:
    """Returns the height [x, z] (m) of the surface of soil [N, 3] (m) over squares of `SIDE`.

    A column of soil up to the height h has for the integral of exp(y / l) dy over its particles
    l (exp(h / l) - 1); here that is solved for h, y over the floor, with l the side of a square. A
    particle has its packed volume, shared to nine squares by quadratic B-splines, those beyond a
    wall back to the wall's own. So it is the soil within about l of the surface that is seen, soil
    that is lowered by some way lowers its surface by that way, and no particle counts for all of a
    square: by the highest particle of each, one that crossed a border by a micrometre changed two
    squares by a layer.
    """
    cells = [round(box.size[axis] / SIDE) for axis in (0, 2)]
    side = np.array([box.size[0], box.size[2]]) / cells
    place = (positions[:, [0, 2]] - scenes.CORNER) / side
    nearest = np.floor(place).astype(int)
    away = place - nearest - 0.5
    weights = np.stack([0.5 * (0.5 - away) ** 2, 0.75 - away**2, 0.5 * (0.5 + away) ** 2])
    volume = float(np.prod(box.size)) / len(positions)
    total = np.zeros(cells)
    share = volume / (side.prod() * SIDE) * np.exp((positions[:, 1] - scenes.CORNER) / SIDE)
    for i in range(3):
        for k in range(3):
            square = np.clip(nearest + [i - 1, k - 1], 0, np.array(cells) - 1)
            np.add.at(total, tuple(square.T), share * weights[i, :, 0] * weights[k, :, 1])
    return scenes.CORNER + SIDE * np.log1p(total)
