"""How far the ground truth is from its own limit: the same cases on finer and coarser grids.

    python -m mpm.verification.ladder --json=mpm/verification/ladder.json \\
        --picture=mpm/verification/ladder.png
    python -m mpm.verification.ladder --cases=excavation:186 --variants=base,cubic_6.67

One thing changes at a time: the cells, the particles a cell, the reach of the contact, the interval
of the exchange. Every figure stands beside those of the solver as it is (`base`) and of cubic cells
of the same size in the plane (`cubic_6.67`, `cubic_4.17`). Each run is kept in the JSON when it is
made; the same command goes on with those that are absent (a base run takes about a minute of one
core, the finest ones ten).

The limit of the draft is extrapolated over the cells, F(h) = F0 + a h^p, with p from 1 to 2: the
fit with p = 1.5, and half the range over p as its error.
"""

import dataclasses
import json
import os
import sys
import time

import numpy as np
from absl import app, flags, logging
from tqdm import tqdm

from mpm import packing, run, scenes
from mpm.constitutive import make_soil
from mpm.files import write_json
from mpm.simulation import Settings
from mpm.verification.density import moved_density
from mpm.verification.surfaces import surface
from mpm.versions import SOLVER_VERSION

_JSON = flags.DEFINE_string(
    'json', os.path.join('outputs', 'ladder.json'), 'Where runs are kept; those there are not made.'
)
_PICTURE = flags.DEFINE_string('picture', None, 'Picture of the draft over the cells.')
_CASES = flags.DEFINE_list('cases', None, 'Only these: excavation:186,wheel:122.')
_VARIANTS = flags.DEFINE_list('variants', None, 'Only these (see VARIANTS).')

MEAN = 5  # frames, of a mean force
# Case -> frames that are simulated and the first that counts.
CASES = {
    'excavation:186': (80, 20),
    'excavation:22': (80, 20),
    'excavation:lift_0003': (160, 20),
    'excavation:press_0000': (100, 15),
    'excavation:reverse_0002': (160, 20),
    'wheel:122': (80, 20),
    'wheel:slip_0000': (80, 20),
}


@dataclasses.dataclass(frozen=True)
class Variant:
    """Cells (m) over those of the scene, particles a cell, exchanges a frame, contact reach (m)."""

    plane: float = 1.0
    across: float = 1.0
    per_cell: float = scenes.PER_CELL
    exchanges: int = 9
    reach: float | None = None


VARIANTS = {
    'base': Variant(),
    'cubic': Variant(across=1.0 / 3.0),
    'cells_2': Variant(2.0, 2.0),
    'cells_1.5': Variant(1.5, 1.5),
    'cells_0.75': Variant(0.75, 0.75),
    'particles_1': Variant(per_cell=1.0),
    'particles_4': Variant(per_cell=4.0),
    'exchanges_18': Variant(exchanges=18),
    'exchanges_5': Variant(exchanges=5),
    'reach_half': Variant(reach=0.5),
    'reach_double': Variant(reach=2.0),
}


def box_of(box: scenes.Bin, variant: Variant) -> scenes.Bin:
    """Returns the bin of a variant; its width grows to whole cells, its length has them."""
    dx = box.size[0] / max(8, round(box.size[0] / (box.dx * variant.plane)))
    count_z = max(2, round(box.size[2] / (box.dz * variant.across)))
    return scenes.sampled(
        box.size, dx, box.size[2] / count_z, 1, box.height, box.bounds, variant.per_cell
    )


def measured(name: str, variant: Variant) -> dict:
    """Simulates a case on the grid of a variant.

    Returns:
        `force` (N) and `surface` (m) over time and place, the density of moved soil over the bed's,
        the cell, the reach of the contact (m) and the CPU time (s).
    """
    scene_name, case = name.split(':')
    case = int(case) if case.isdecimal() else case
    scene = scenes.scene_named(scene_name)
    scene = dataclasses.replace(scene, bin=box_of(scene.bin, variant))
    frames, _ = CASES[name]
    settings = Settings(exchange=1.0 / (scenes.FRAME_RATE * variant.exchanges))
    motion = run.prepared(scene, case, settings)
    particles, _ = packing.settle(scene.bin, make_soil(1.5e6, scenes.PACKING_MU_S), 0)
    started = time.process_time()
    simulation = run.make_simulation(scene, motion, particles, settings)
    solver = simulation._solver
    if variant.reach is not None:
        radius = variant.reach * solver.law.radius
        solver.law = solver.law._replace(radius=radius)
    force = [
        simulation.frame()[0] for _ in tqdm(range(motion.drive.lead_in + frames), leave=False)
    ]
    start, end = particles[:, :3], simulation.positions()
    return {
        'force': np.round(force[motion.drive.lead_in :], 3).tolist(),
        'surface': np.round(surface(end, scene.bin), 6).tolist(),
        'density': moved_density(start, end, simulation),
        'cell_m': [float(side) for side in simulation.grid.cell],
        'reach_m': float(solver.law.radius),
        'cpu_s': round(time.process_time() - started, 1),
    }


def compared(found: dict, reference: dict, first: int) -> dict:
    """Returns what a run differs by from a reference.

    Returns:
        Mean draft and vertical force (N) from the frame `first` on, their ratio to the reference's,
        the relative L2 difference of means over five frames, and of the surface in mm RMS.
    """
    force, other = (np.array(run['force'])[first:] for run in (found, reference))
    rows = len(force) // MEAN * MEAN
    means, others = (f[:rows].reshape(-1, MEAN, 3).mean(axis=1) for f in (force, other))
    apart = np.array(found['surface']) - np.array(reference['surface'])
    return {
        'draft_N': float(force[:, 0].mean()),
        'vertical_N': float(force[:, 1].mean()),
        'draft_ratio': float(force[:, 0].mean() / other[:, 0].mean()),
        'vertical_ratio': float(force[:, 1].mean() / other[:, 1].mean()),
        'force_5_frames': float(np.linalg.norm(means - others) / np.linalg.norm(others)),
        'surface_mm': 1e3 * float(np.sqrt((apart**2).mean())),
        'density': found['density'],
    }


def limit(cells: np.ndarray, drafts: np.ndarray) -> tuple[float, float]:
    """Returns the draft (N) at cells of no size and its error: see the module.

    Args:
        cells: float64 [K], sizes in the plane, m, K >= 3.
        drafts: float64 [K], N.
    """
    limits = []
    for order in (1.0, 1.5, 2.0):
        design = np.stack([np.ones(len(cells)), cells**order], axis=1)
        limits.append(float(np.linalg.lstsq(design, drafts, rcond=None)[0][0]))
    return limits[1], (max(limits) - min(limits)) / 2.0


def table(path: str) -> str:
    """Returns the stored ladder as Markdown, each variant beside `cubic`."""
    content = _read(path)
    lines = [
        '| case | variant | cells mm | reach mm | draft N | of cubic | vertical N '
        '| force, 5 frames | surface mm | density | CPU s |',
        '|---|---|---|---|---|---|---|---|---|---|---|',
    ]
    for name, runs in content.items():
        reference = runs.get('cubic') or runs.get('base')
        if reference is None:
            continue
        for variant, found in runs.items():
            row = compared(found, reference, CASES[name][1])
            cell = ' x '.join(f'{1e3 * side:.3g}' for side in found['cell_m'][1:])
            density = '-' if row['density'] is None else f'{row["density"]:.3f}'
            lines.append(
                f'| {name} | {variant} | {cell} | {1e3 * found["reach_m"]:.2f} '
                f'| {row["draft_N"]:.1f} | {row["draft_ratio"]:.3f} | {row["vertical_N"]:.1f} '
                f'| {row["force_5_frames"]:.3f} | {row["surface_mm"]:.2f} | {density} '
                f'| {found["cpu_s"]:.0f} |'
            )
        cells, drafts = _over_cells(runs, CASES[name][1])
        if len(cells) >= 3:
            value, error = limit(cells, drafts)
            found = f'{value:.0f} +- {error:.0f}'
            lines.append(f'| {name} | limit of fine cells | 0 | | {found} |||||||')
    return '\n'.join(lines)


def _over_cells(runs, first):
    names = [n for n in ('cells_0.75', 'base', 'cells_1.5', 'cells_2') if n in runs]
    cells = np.array([runs[n]['cell_m'][0] for n in names])
    return cells, np.array([np.array(runs[n]['force'])[first:, 0].mean() for n in names])


def draw(path: str, output: str) -> None:
    """Draws the draft over the size of the cells, of each case over that of the base."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4.5), layout='constrained')
    for name, runs in _read(path).items():
        cells, drafts = _over_cells(runs, CASES[name][1])
        if len(cells) < 2:
            continue
        at = runs['base']['cell_m'][0]
        base = drafts[list(cells).index(at)]
        (line,) = axes.plot(cells / at, drafts / base, 'o-', label=name)
        if 'cubic' in runs:
            cubic = np.array(runs['cubic']['force'])[CASES[name][1] :, 0].mean()
            axes.plot([1.0], [cubic / base], 'x', color=line.get_color())
        if len(cells) >= 3:
            value, error = limit(cells, drafts)
            axes.errorbar([0.0], [value / base], abs(error / base), fmt='s', color=line.get_color())
    axes.set_xlabel('cell size over that of the ground truth')
    axes.set_ylabel('mean force along x over that of the ground truth')
    axes.set_title('Squares: extrapolated limit. Crosses: cubic cells.', fontsize=10, loc='left')
    axes.legend(fontsize=8)
    figure.savefig(output, dpi=120)


def _read(path) -> dict:
    if not os.path.exists(path):
        return {}
    with open(path, encoding='utf-8') as file:
        content = json.load(file)
    if content.get('solver_version') != SOLVER_VERSION:
        raise ValueError(f'{path} is not a ladder of solver version {SOLVER_VERSION}; name another')
    return content['cases']


def main(argv):
    if len(argv) > 1:
        raise app.UsageError(f'unknown arguments: {argv[1:]}')
    path = _JSON.value
    try:
        content = _read(path)
        os.makedirs(os.path.dirname(path) or '.', exist_ok=True)
        for variant in _VARIANTS.value or VARIANTS:
            for name in _CASES.value or CASES:
                if variant in content.setdefault(name, {}):
                    continue
                content[name][variant] = measured(name, VARIANTS[variant])
                print(f'{name} {variant}: {content[name][variant]["cpu_s"]} s', flush=True)
                write_json(path, {'solver_version': SOLVER_VERSION, 'cases': content})
        print(table(path))
        if _PICTURE.value:
            draw(path, _PICTURE.value)
    except (ValueError, OSError, KeyError) as error:
        logging.error('%s', error)
        sys.exit(1)


if __name__ == '__main__':
    app.run(main)
