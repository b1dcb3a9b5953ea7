"""How densely soil is packed, by counting: the law knows but the volume that a particle states."""

import dataclasses

import numpy as np

from mpm import scenes
from mpm.constitutive import DILATION
from mpm.contact import signed_distances
from mpm.simulation import Settings
from mpm.verification.convergence import drive, packed
from mpm.verification.rows import Check, reported
from mpm.verification.surfaces import surface

RADIUS = 0.03  # m, of the spheres in which particles are counted: 40 of them
APART = 0.015  # m, between the middles of spheres
MOVED = 0.03  # m, from where soil counts as moved
DENSER = 2  # times as many particles along each axis, of `more_particles`


def spheres(positions: np.ndarray, box: scenes.Bin) -> np.ndarray:
    """Returns the middles [M, 3] (m) of spheres on a lattice that lie in the soil [N, 3] (m)."""
    height = surface(positions, box)
    nx, nz = height.shape
    # A surface sees half a square beyond the next one: the lowest of five by five is below it.
    around = np.pad(height, 2, mode='edge')
    lowest = np.min([around[i : i + nx, k : k + nz] for i in range(5) for k in range(5)], axis=0)
    high = [box.size[0], positions[:, 1].max() - scenes.CORNER, box.size[2]]
    axes = [np.arange(RADIUS, end - RADIUS, APART) for end in high]
    places = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 3)
    across = places[:, [0, 2]] / [box.size[0], box.size[2]] * height.shape
    is_deep = places[:, 1] + scenes.CORNER < lowest[tuple(across.astype(int).T)] - RADIUS
    return places[is_deep] + scenes.CORNER


def count(positions: np.ndarray, middles: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Counts the particles [N, 3] in each of M spheres, and sums up their `values` [N].

    Returns:
        Numbers and sums, float64 [2, M].
    """
    order = np.argsort(positions[:, 0])
    x, values = positions[order], values[order]
    found = np.zeros((2, len(middles)))
    for column in np.unique(middles[:, 0]):
        first, last = np.searchsorted(x[:, 0], [column - RADIUS, column + RADIUS])
        for m in np.flatnonzero(middles[:, 0] == column):
            is_in = ((x[first:last] - middles[m]) ** 2).sum(axis=1) < RADIUS**2
            found[:, m] = np.count_nonzero(is_in), values[first:last][is_in].sum()
    return found


def _driven(scene: scenes.Scene, case: int, frames: int, dilation: float = 0.0):
    """Drives a case of soil of a `dilation`.

    Returns:
        the mean force along x, N; the simulation; the density of soil that the blade has moved
        over that of the bed before; and in how many spheres it was counted.
    """
    box, settings = scene.bin, Settings(dilation=dilation)
    start = packed(box, settings.youngs_modulus)[:, :3]
    force, simulation = drive(scene, case, frames, settings)
    end = simulation.positions()
    way = np.linalg.norm(end - start, axis=1)
    before, _ = count(start, spheres(start, box), way)
    middles = spheres(end, box)
    away = signed_distances(simulation.drive.body, simulation.pose, middles)
    after, ways = count(end, middles[away > RADIUS], way)
    is_moved = ways > MOVED * after
    density = float(after[is_moved].mean() / before.mean())
    return float(force[:, 0].mean()), simulation, density, np.count_nonzero(is_moved)


def _apart_mm(one, box, other, other_box) -> float:
    """How far the surfaces of two simulations are apart, mm RMS over squares."""
    apart = surface(one.positions(), box) - surface(other.positions(), other_box)
    return 1e3 * float(np.sqrt((apart**2).mean()))


def moved_soil(case: int, frames: int) -> list[Check]:
    """The density of soil that a blade has moved, over that of the bed before."""
    _, _, density, n_sphere = _driven(scenes.EXCAVATION, case, frames)
    name = (
        f'excavation {case}: density of soil that moved over {1e3 * MOVED:.0f} mm over that before'
    )
    note = f'{frames} frames, by counting in {n_sphere} spheres of 30 mm'
    return [Check(name, density, 1.0, 0.05, note)]


def dilating_soil(case: int, frames: int) -> list[Check]:
    """What `moved_soil` counts, of soil that dilates (eq. 7); and its mean force and its surface
    beside those of soil that does not."""
    box = scenes.EXCAVATION.bin
    force, simulation, before, _ = _driven(scenes.EXCAVATION, case, frames)
    other, dilating, density, n_sphere = _driven(scenes.EXCAVATION, case, frames, DILATION)
    name = f'excavation {case}: dilating soil'
    return [
        Check(f'{name}, density of soil that moved over {1e3 * MOVED:.0f} mm over that before',
              density, 1.0, 0.05, f'{frames} frames, {n_sphere} spheres; {before:.3f} without'),
        reported(f'{name}, mean force over that without', other / force,
                 f'{frames} frames, {force:.1f} N without'),
        reported(f'{name}, surface in mm RMS', _apart_mm(dilating, box, simulation, box),
                 'squares'),
    ]  # fmt: skip


def more_particles(case: int, frames: int, dilation: float = 0.0) -> list[Check]:
    """The same cells with particles half as far apart: what the data's few particles change.

    `dilation` is of the few; the many, which keep their volume, have none.
    """
    scene = scenes.EXCAVATION
    box = dataclasses.replace(scene.bin, lattice=tuple(DENSER * n for n in scene.bin.lattice))
    force, simulation, density, _ = _driven(scene, case, frames, dilation)
    more, other, denser, _ = _driven(dataclasses.replace(scene, bin=box), case, frames)
    name = f'excavation {case}: {DENSER**3} times the particles'
    if dilation:
        name = f'{name} and few of dilating soil'
    rms = _apart_mm(other, box, simulation, scene.bin)
    return [
        reported(f'{name}, mean force over that before', more / force,
                 f'{frames} frames, {force:.1f} N before'),
        reported(f'{name}, density of soil that moved over {1e3 * MOVED:.0f} mm', denser,
                 f'{density:.3f} before'),
        reported(f'{name}, surface in mm RMS', rms, 'squares'),
    ]  # fmt: skip
