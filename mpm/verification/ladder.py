"""How far the ground truth is from its own limit: the same cases on finer and coarser grids.

    python -m mpm.verification.ladder --json=mpm/verification/ladder.json \\
        --picture=mpm/verification/ladder.png
    python -m mpm.verification.ladder --rows=excavation:186/base,excavation:186/cubic

One thing changes at a time: the cells, the particles a cell, the reach of the contact, the interval
of the exchange; for a bucket with side plates only the cells across. Every figure stands beside
those of the solver as it is (`base`) and of cubic cells of the same size in the plane (`cubic`).
Each run is kept in the JSON when it is made; the same command goes on with those that are absent (a
base run takes about a minute of one core, the finest ones ten).

The limit of the draft is extrapolated over the cells, F(h) = F0 + a h^p, with p from 1 to 2: the
fit with p = 1.5, and half the range over p as its error.
"""

import dataclasses
import itertools
import time
from functools import partial

import numpy as np

from mpm import run, scenes
from mpm.motions import catalogue
from mpm.picture import panels
from mpm.simulation import Settings
from mpm.verification import bed
from mpm.verification.rows import Jobs, read_kept, run_report
from mpm.verification.run_rows import frames_of, packed, simulation_of
from pca_tools.storage import markdown

MEAN = 5  # frames, of a mean force
# Case -> frames that are simulated, the first that counts, and the axis of the force that matters:
# along x, or upwards for tools that are pressed or leave the soil in between.
CASES = {
    'excavation:186': (80, 20, 0),
    'excavation:22': (80, 20, 0),
    'excavation:lift_0003': (160, 20, 0),
    'excavation:press_0000': (100, 15, 1),
    'excavation:reverse_0002': (160, 20, 1),
    'wheel:122': (80, 20, 0),
    'wheel:slip_0000': (80, 20, 0),
}
TOOLS, AXES = {'blade': 'excavation', 'wheel': 'wheel'}, ('along x', 'upwards')
THROWN = {('wheel:slip_0000', 'reach_double')}  # contact that far throws soil out of the grid
# 15 cm wide, with plates of 20 mm.
BUCKET = {'excavation:tools_0023': (100, 45, 0)}


@dataclasses.dataclass(frozen=True)
class Variant:
    """Cells and contact reach over those of the scene, particles a cell, exchanges a frame."""

    plane: float = 1.0
    across: float = 1.0
    per_cell: float = scenes.PER_CELL
    exchanges: int = 9
    reach: float = 1.0


VARIANTS = {
    'base': Variant(),
    'cubic': Variant(across=1.0 / 3.0),
    'cells_2': Variant(2.0, 2.0),
    'cells_1.5': Variant(1.5, 1.5),
    'cells_0.75': Variant(0.75, 0.75),
    'particles_1': Variant(per_cell=1.0),
    'exchanges_18': Variant(exchanges=18),
    'reach_double': Variant(reach=2.0),
}
ACROSS = {
    'base': Variant(),
    'across_half': Variant(across=0.5),
    'cubic': Variant(across=1.0 / 3.0),
    'across_sixth': Variant(across=1.0 / 6.0),
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
        `force` (N), means over `MEAN` frames from the first that counts on, [K, 3]; `surface`, in
        hundredths of a millimetre, [x, z]; the density of moved soil over the bed's, the cell and
        the reach of the contact (m), and the CPU time (s).
    """
    scene_name, case = name.split(':')
    case = int(case) if case.isdecimal() else case
    scene = catalogue.in_bin(scenes.SCENES[scene_name], case)
    scene = dataclasses.replace(scene, bin=box_of(scene.bin, variant))
    frames, first, _ = (CASES | BUCKET)[name]
    settings = Settings(exchange=1.0 / (scenes.FRAME_RATE * variant.exchanges))
    motion = run.prepared(scene, case, settings)
    start = packed(scene.bin)[:, :3]
    started = time.process_time()
    simulation = simulation_of(scene, motion, settings)
    solver = simulation._solver
    solver.law = solver.law._replace(radius=variant.reach * solver.law.radius)
    force = frames_of(simulation, motion.drive.lead_in + frames)[:, :3]
    end = simulation.positions()
    force = force[motion.drive.lead_in + first :]
    count = len(force) // MEAN  # what is left over is dropped
    means = force[: count * MEAN].reshape(count, MEAN, 3).mean(axis=1)
    return {
        'force': np.round(means, 2).tolist(),
        'surface': np.round(1e5 * bed.surface(end, scene.bin)).astype(int).tolist(),
        'density': bed.moved_density(start, end, simulation),
        'cell_m': [float(side) for side in simulation.grid.cell],
        'reach_m': float(solver.law.radius),
        'cpu_s': round(time.process_time() - started, 1),
    }


def compared(found: dict, reference: dict) -> dict:
    """Returns what a run differs by from a reference.

    Returns:
        Mean draft and vertical force (N); the difference of both means over the length of the
        reference's mean force; the relative L2 difference of means over five frames; that of the
        surface in mm RMS; the density of moved soil over the bed's (None: too little moved).
    """
    force, other = np.array(found['force']), np.array(reference['force'])
    change = (force.mean(axis=0) - other.mean(axis=0)) / np.linalg.norm(other.mean(axis=0))
    apart = np.array(found['surface']) - np.array(reference['surface'])
    return {
        'draft_N': float(force[:, 0].mean()),
        'vertical_N': float(force[:, 1].mean()),
        'draft_change': float(change[0]),
        'vertical_change': float(change[1]),
        'force_5_frames': float(np.linalg.norm(force - other) / np.linalg.norm(other)),
        'surface_mm': 1e-2 * float(np.sqrt((apart**2).mean())),
        'density': found['density'],
    }


def limit(cells: np.ndarray, drafts: np.ndarray) -> tuple[float, float]:
    """Returns the draft (N) at cells of no size and its error (see the module), from the drafts [K]
    (N) at cells [K] (m, in the plane), K >= 3."""
    limits = [_fit(cells, drafts, order)[0] for order in (1.0, 1.5, 2.0)]
    return limits[1], (max(limits) - min(limits)) / 2.0


def order_of(cells: np.ndarray, drafts: np.ndarray) -> float:
    """Returns the p from 0.5 to 4 with which F(h) = F0 + a h^p meets the drafts [K] best."""
    return float(min(np.linspace(0.5, 4.0, 71), key=lambda p: _fit(cells, drafts, p)[1]))


def _fit(cells, drafts, order):
    """F0, and the sum of the squares that are left."""
    design = np.stack([np.ones(len(cells)), cells**order], axis=1)
    found = np.linalg.lstsq(design, drafts, rcond=None)[0]
    return float(found[0]), float(((design @ found - drafts) ** 2).sum())


# What a row of the summary shows of `compared`: title, form.
_SHOWN = {
    'draft_change': ('draft', '+.1%'), 'vertical_change': ('vertical force', '+.1%'),
    'force_5_frames': ('five frames', '.3f'), 'surface_mm': ('surface, mm', '.2f'),
    'density': ('density', '.3f'),
}  # fmt: skip


def summary(path: str) -> str:
    """Returns the ladder as Markdown, a row for each variant: medians and worst over the cases."""
    rows = []
    for what, variant in itertools.product(TOOLS, VARIANTS):
        found = [
            compared(runs[variant], runs['cubic'])
            for name, runs in _read(path).items()
            if name in CASES and name.startswith(TOOLS[what]) and {variant, 'cubic'} <= runs.keys()
        ]
        cells = []
        for key, (_, form) in _SHOWN.items():
            values = [row[key] for row in found if row[key] is not None]
            worst = max(values, key=abs, default=None)
            cells.append(f'{np.median(values):{form}} ({worst:{form}})' if values else '')
        if found and variant != 'cubic':
            rows.append((f'{what}, {variant}', f'{len(found)}', *cells))
    titles = (title for title, _ in _SHOWN.values())
    return markdown.table(('variant', 'cases', *titles), rows)


def side_plates(path: str) -> str:
    """Returns, as Markdown, a bucket on shorter cells across; all over the shortest ones."""
    rows = []
    for runs in (_read(path).get(name, {}) for name in BUCKET):
        for variant in ACROSS if 'across_sixth' in runs else ():
            row = compared(runs[variant], runs['across_sixth'])
            rows.append((
                f'{1e3 * runs[variant]["cell_m"][2]:.3g}', f'{row["draft_N"]:.0f}',
                f'{row["vertical_N"]:.0f}', f'{row["force_5_frames"]:.3f}',
                f'{row["surface_mm"]:.2f}',
            ))  # fmt: skip
    header = ('cells across, mm', 'along x, N', 'upwards, N', 'five frames', 'surface, mm')
    return markdown.table(header, rows)


def limits(path: str) -> str:
    """Returns, as Markdown, how far the ground truth is from the limit of fine cells."""
    rows = []
    for name, _, cells, forces, base in _laddered(path):
        value, error = limit(cells, forces)
        finer = f'{base / forces[0] - 1.0:+.0%}' if base != forces[0] else ''
        order = f'{order_of(cells, forces):.1f}' if len(cells) > 3 else ''
        rows.append((
            name, AXES[CASES[name][2]], f'{base:.0f}', finer, order,
            f'{value:.0f} +- {error:.0f}', f'{base / value - 1.0:+.0%}',
        ))  # fmt: skip
    header = (
        'case', 'force', 'ground truth, N', 'over cells of 3/4', 'order', 'limit, N',
        'ground truth over it',
    )  # fmt: skip
    return markdown.table(header, rows)


def in_short(path: str) -> str:
    """One line: by how much the force of the ground truth differs from finer grids."""
    finer: dict[str, list] = {'excavation': [], 'wheel': []}
    whole: dict[str, list] = {'excavation': [], 'wheel': []}
    for name, _, cells, forces, base in _laddered(path):
        scene = name.split(':')[0]
        finer[scene].append(abs(base / forces[0] - 1.0))
        whole[scene].append(abs(base / limit(cells, forces)[0] - 1.0))

    def span(shares):
        return f'{100 * min(shares):.0f} to {100 * max(shares):.0f} %'

    return (
        f"- **How far the solver is off**: on cells of three quarters of the size a blade's force "
        f"differs by {span(finer['excavation'])}, a wheel's drawbar by {span(finer['wheel'])}. "
        f'Extrapolated to infinitely fine cells, the differences are {span(whole["excavation"])} '
        f'and {span(whole["wheel"])}.'
    )


def over_cells(name, runs):
    """Cells (m) and mean forces (N) of the variants of a case that differ in the cells alone."""
    found = [runs[n] for n in ('cells_0.75', 'base', 'cells_1.5', 'cells_2') if n in runs]
    cells = np.array([run['cell_m'][0] for run in found])
    return cells, np.array([_mean(run, name) for run in found])


def _mean(run, name):
    """Mean force (N) of a run along the axis that matters in its case."""
    return np.mean(run['force'], axis=0)[CASES[name][2]]


def _laddered(path):
    """Yields the cases with three sizes of cells or more: name, runs, `over_cells`, and the force
    of the ground truth."""
    for name, runs in _read(path).items():
        if name in CASES and len(over_cells(name, runs)[0]) >= 3:
            yield name, runs, *over_cells(name, runs), _mean(runs['base'], name)


def draw(path: str, output: str) -> None:
    """Draws the draft over the size of the cells, of each case over that of the base."""
    figure, ((axes,),) = panels(1, 1, (7, 4.5))
    for name, runs, cells, forces, base in _laddered(path):
        label = f'{name}, {AXES[CASES[name][2]]}'
        (line,) = axes.plot(cells / runs['base']['cell_m'][0], forces / base, 'o-', label=label)
        if 'cubic' in runs:
            axes.plot([1.0], [_mean(runs['cubic'], name) / base], 'x', color=line.get_color())
        value, error = limit(cells, forces)
        axes.errorbar([0.0], [value / base], abs(error / base), fmt='s', color=line.get_color())
    axes.set_xlabel('cell size over that of the ground truth')
    axes.set_ylabel('mean force over that of the ground truth')
    axes.set_title(
        'Mean force over the size of the cells (squares: extrapolated; crosses: cubic cells)',
        fontsize=11, loc='left',
    )  # fmt: skip
    axes.legend(fontsize=8)
    figure.savefig(output, dpi=120)


def _read(path) -> dict:
    return read_kept(path).get('cases', {})


def jobs(values=None) -> Jobs:
    """Returns what there is to make: all cases of a variant, then the next variant."""
    made: Jobs = {}
    for cases, variants in ((CASES, VARIANTS), (BUCKET, ACROSS)):
        for (variant, what), name in itertools.product(variants.items(), cases):
            if (name, variant) not in THROWN:
                made['cases', name, variant] = partial(measured, name, what)
    return made


if __name__ == '__main__':
    tables = summary, limits, side_plates
    run_report('ladder', jobs, lambda path: '\n\n'.join(table(path) for table in tables), draw)
