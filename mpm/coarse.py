"""A scene on a coarser grid, for what the solver gives at less cost; the same particles, or fewer.

Cell size grows by about the factor (length stays a whole number of cells), the time step with it.
Where cells grow so far that fewer particles fill them as well, only every n-th particle of the
packing is simulated, and always those that the fine run writes: columns of positions match.
"""

import dataclasses

import numpy as np

from mpm.scenes import Bin, Scene

# Planes of particles stand at most so many cells apart (1.07 in the fine excavation). The wheel's
# every third particle leaves every third plane: at 1.5 cells apart it sank 8 mm too deep.
PLANE_GAP = 1.2


def coarsened(scene: Scene, factor: float) -> Scene:
    """Returns the scene with cells `factor` times as long, to the next whole number of cells.

    The walls across stand on planes of nodes, so they may move outwards, by less than half a cell
    each; `Bin.wall_gap` says how far. Particles are thinned by a divisor of `keep_every`, as far as
    cells hold no fewer of them than before and `PLANE_GAP` allows.

    Raises:
        ValueError: if the factor is below 1, or fewer than 8 cells would be left.
    """
    box = scene.bin
    if not factor >= 1.0:
        raise ValueError(f'grid factor is {factor}, must be at least 1: 2 doubles the cell size')
    cells = round(box.size[0] / box.dx / factor)
    if cells < 8:
        raise ValueError(
            f'grid factor {factor} leaves {cells} cells on the {box.size[0]} m of the bin; at '
            f'least 8 are needed'
        )
    dx = box.size[0] / cells
    across = int(np.ceil(box.size[2] / dx - 1e-6))
    divisors = [n for n in range(1, box.keep_every + 1) if box.keep_every % n == 0]
    thinning = max(
        n
        for n in divisors
        if n == 1 or (n <= (dx / box.dx) ** 3 and _plane_gap(box, n) <= PLANE_GAP * dx)
    )
    return dataclasses.replace(
        scene,
        bin=dataclasses.replace(
            box,
            dx=dx,
            wall_gap=max(0.0, round((across * dx - box.size[2]) / 2.0, 12)),
            simulate_every=thinning,
            keep_every=box.keep_every // thinning,
        ),
    )


def _plane_gap(box: Bin, every: int) -> float:
    """Largest distance between neighbouring lattice planes that hold every n-th particle, m."""
    kept = np.unravel_index(np.arange(0, np.prod(box.lattice), every), box.lattice)
    planes = [np.diff(np.unique(index)).max() for index in kept]
    return float((np.array(planes) * box.size / box.lattice).max())


def thinned(packed: tuple[np.ndarray, dict], scene: Scene) -> tuple[np.ndarray, dict]:
    """Returns a settled packing (`packing.settle`) with the particles that the scene simulates."""
    particles, statistics = packed
    particles = particles[:: scene.bin.simulate_every].copy()
    return particles, statistics | {'particles': len(particles)}
