"""What the solver's own parameters change: exchange interval, contact, damping, step, dilation.

One excavation case, one parameter at a time, all others at their values. Nothing is tuned by it:
it says how far the ground truth depends on what no measurement fixes.

Examples:
    python -m reports solver_sweeps --json=docs/solver/sweeps.json
    python -m reports solver_sweeps --coarse --frames=30 --json=/tmp/sweeps.json
"""

import contextlib
import time

import numpy as np
from absl import flags
from tqdm import tqdm

from mpm import contact, experiments, packing, scenes, simulation, solver, stability
from mpm.constitutive import make_soil
from mpm.run import make_simulation, soil_of
from mpm.verification.surfaces import surface
from mpm.versions import SOLVER_VERSION
from pca_tools import files
from reports import command, markdown, record

# Parameter -> its values; the first is the one that the solver has.
SWEEPS = {
    'exchanges per frame': (simulation.INTERVALS, 9, 36, 72),
    'contact radius, spacings': (contact.RADIUS, 0.0, 0.25, 0.75),
    'contact stiffness, of M h': (contact.STIFFNESS, 0.0625, 1.0),
    'damping, of dx / c': (stability.DAMPING, 0.0, 0.03, 0.12),
    'steps, of the fewest': (1, 2, 4),
    'dilation K': (0.0, 2.5, 6.0, 12.0),
}


@contextlib.contextmanager
def changed(parameter: str, value: float):
    """Changes one of the solver's constants for a while."""
    places = {
        'contact radius, spacings': [(contact, 'RADIUS', value)],
        'contact stiffness, of M h': [(contact, 'STIFFNESS', value)],
        'damping, of dx / c': [(stability, 'DAMPING', value)],
    }.get(parameter, [])
    if parameter == 'exchanges per frame':
        interval = 1 / (scenes.FRAME_RATE * value)
        places = [(solver, 'EXCHANGE', interval), (simulation, 'EXCHANGE', interval)]
        places += [(simulation, 'INTERVALS', value)]
    before = [getattr(module, name) for module, name, _ in places]
    try:
        for module, name, new in places:
            setattr(module, name, new)
        yield
    finally:
        for (module, name, _), old in zip(places, before):
            setattr(module, name, old)


def drive(scene, case, particles, frames, parameter, value):
    """Returns force [frames, 3] (N), the heights of the surface (m), deepest cells and CPU s."""
    settings = simulation.Settings(dilation=value if parameter == 'dilation K' else 0.0)
    soil = soil_of(scene, scene.parameters(case), settings)
    with changed(parameter, value):
        if parameter == 'steps, of the fewest':
            fewest = make_simulation(scene, scene.parameters(case), soil, particles, settings)
            settings = simulation.Settings(steps_per_frame=value * fewest.steps)
        made = make_simulation(scene, scene.parameters(case), soil, particles, settings)
        started, force, deepest = time.process_time(), [], 0.0
        for _ in tqdm(range(frames), desc=f'{parameter} {value:g}', unit='frame', leave=False):
            force.append(made.frame()[0])
            deepest = max(deepest, made.penetration()['deepest_cells'])
    return (
        np.array(force),
        surface(made.positions(), scene.bin),
        deepest,
        time.process_time() - started,
    )


def measure(scene, case: int, frames: int, path: str) -> dict:
    """Returns the rows of all sweeps, kept in a file as they are made.

    Raises:
        ValueError: if the file holds the rows of something else.
    """
    identity = {
        'case': case,
        'frames': frames,
        'cell_size_m': scene.bin.dx,
        'solver_version': SOLVER_VERSION,
    }
    summary = record.resume(path, identity, {'surface_m': None, 'rows': []})
    done = {(row['parameter'], row['value']) for row in summary['rows']}
    # All sweeps share the row of the solver as it is, which comes first.
    base = next((name, values[0]) for name, values in SWEEPS.items())
    todo = [base] + [(name, value) for name, values in SWEEPS.items() for value in values[1:]]
    todo = [choice for choice in todo if choice not in done]
    if todo:
        soil = make_soil(simulation.Settings().youngs_modulus, scenes.PACKING_MU_S)
        particles = packing.settle(scene.bin, soil, 0)[0]
    for name, value in todo:
        force, height, deepest, cpu = drive(scene, case, particles, frames, name, value)
        if summary['surface_m'] is None:
            summary['surface_m'] = height.tolist()
        apart = height - np.array(summary['surface_m'])
        summary['rows'].append(
            {
                'parameter': name,
                'value': value,
                'draft_N': float(force[:, 0].mean()),
                'vertical_N': float(force[:, 1].mean()),
                'roughness': float(np.abs(np.diff(force[:, 0], 2)).mean() / force[:, 0].mean()),
                'surface_mm': float(1e3 * np.sqrt((apart**2).mean())),
                'deepest_cells': deepest,
                'cpu_s': round(cpu, 1),
            }
        )
        files.write_json(path, summary)
    return summary


def table(path: str) -> str:
    """The rows of a file as Markdown, each beside the solver as it is."""
    summary = files.read_json(path)
    base = summary['rows'][0]['draft_N']
    header = ('parameter', 'value', 'mean draft N', 'change %', 'vertical N', 'second difference '
              'of the draft, %', 'surface mm RMS', 'deepest, cells', 'CPU s')  # fmt: skip
    rows = [
        (
            row['parameter'],
            row['value'],
            row['draft_N'],
            f'{100 * (row["draft_N"] / base - 1):+.2f}',
            row['vertical_N'],
            100 * row['roughness'],
            row['surface_mm'],
            row['deepest_cells'],
            row['cpu_s'],
        )
        for row in summary['rows']
    ]
    return markdown.table(header, rows)


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('json', None, 'Where rows are kept; those there stay.', required=True)
    flags.DEFINE_integer('case', 186, 'Which case of the excavation.')
    flags.DEFINE_integer('frames', 60, 'Frames of each run.', lower_bound=2)
    flags.DEFINE_bool('coarse', False, 'On cells twice as long, a tenth of the cost.')


def main(values, _) -> None:
    """Runs the command."""
    scene = scenes.EXCAVATION
    if values.coarse:
        scene = experiments.coarse(scene)
    measure(scene, values.case, values.frames, values.json)
    print(table(values.json))


if __name__ == '__main__':
    command.start(define_flags, main)
