"""The blade's force with the published physics: nonlocal rheology and ten times our stiffness.

Each case is driven from the beginning with our physics (local mu(I), E = 1.5 MPa), with the
published stiffness alone, and with the published physics (granular fluidity, E = 15 MPa); a
stiffness has its own settled packing, all else is the same. Where the published records are there,
figures of theirs over the same frames stand beside. A run is kept in the JSON when it is made; the
same command goes on with those that are absent. 60 frames of a case take three minutes of one core.

Examples:
    python -m reports published_physics --json=docs/solver/published_physics.json \
        --original_path=DIR/Excavation_PCA --picture_path=docs/solver/published_physics.png
    python -m reports published_physics --cases=186 --frames=20 --json=/tmp/physics.json
"""

import time
from functools import cache

import numpy as np
from absl import flags
from tqdm import tqdm

from mpm import packing, scenes
from mpm.constitutive import make_soil
from mpm.run import make_simulation, soil_of
from mpm.simulation import Settings
from mpm.versions import SOLVER_VERSION
from pca_tools import files
from reports import command, markdown, record
from reports.compare_forces import published_forces

SCENE = scenes.EXCAVATION
# Published cases of motion 2, that cuts from the first frame: 2 to 8 cm deep, 8 to 15 cm/s.
CASES = (186, 78, 146, 22, 188)
PHYSICS = {
    'ours': Settings(),
    'stiffness alone': Settings(15e6),
    'published physics': Settings(15e6, 'nonlocal'),
}
SPAN = 10  # frames over which a published force is averaged: theirs is of one substep, and noisy


@cache
def packed(youngs_modulus: float) -> np.ndarray:
    """The settled packing [N, COLUMNS] of the bin for a stiffness (Pa), made once per process."""
    return packing.settle(SCENE.bin, make_soil(youngs_modulus, scenes.PACKING_MU_S), 0)[0]


def simulate(case: int, physics: str, frames: int) -> dict:
    """Drives a case with `PHYSICS`.

    Returns:
        `force_x_N` and `force_y_N` of each frame, the deepest particle of all frames in cells, the
        CPU seconds of the frames and the time step in s.
    """
    settings = PHYSICS[physics]
    parameters = SCENE.parameters(case)
    soil = soil_of(SCENE, parameters, settings)
    made = make_simulation(SCENE, parameters, soil, packed(settings.youngs_modulus), settings)
    started, force, deepest = time.process_time(), [], 0.0
    for _ in tqdm(range(frames), desc=f'{case} {physics}', unit='frame'):
        force.append(made.frame()[0])
        deepest = max(deepest, made.penetration()['deepest_cells'])
    x, y, _ = np.round(force, 2).T.tolist()
    return {
        'case': case,
        'physics': physics,
        'force_x_N': x,
        'force_y_N': y,
        'deepest_cells': deepest,
        'time_step_s': made.dt,
        'cpu_s': round(time.process_time() - started, 1),
    }


def spans(force: np.ndarray) -> list[float]:
    """Returns the means of a force [T] (N) over every `SPAN` frames; frames left over are not."""
    count = len(force) // SPAN
    return [round(float(x), 1) for x in force[: count * SPAN].reshape(count, SPAN).mean(axis=1)]


def figures_of(force: np.ndarray, frames: int) -> dict:
    """Returns what is kept of a published force [T, 3] (N): means over its first frames."""
    driven = np.asarray(force, dtype=np.float64)[1 : frames + 1]
    return {
        'draft_N': float(driven[:, 0].mean()),
        'vertical_N': float(driven[:, 1].mean()),
        'draft_of_spans_N': spans(driven[:, 0]),
    }


def measure(path: str, cases: list[int], frames: int, original_path: str | None) -> dict:
    """Returns the content of the JSON with the runs of all cases, kept as they are made.

    Args:
        path: of the JSON.
        cases: of the excavation grid.
        frames: how many are driven.
        original_path: the published dataset; None: figures of it that are there stay.

    Raises:
        ValueError: the file holds something else; or see `published_forces`.
    """
    identity = {'frames': frames, 'cell_size_m': SCENE.bin.dx, 'solver_version': SOLVER_VERSION}
    content = record.resume(path, identity, {'runs': [], 'records': {}})
    content |= record.provenance()
    if original_path:
        forces = published_forces(SCENE, original_path)
        content['records'] |= {
            str(case): figures_of(forces[case], frames) for case in cases if case in forces
        }
    done = {(run['case'], run['physics']) for run in content['runs']}
    for case in cases:
        for physics in PHYSICS:
            if (case, physics) not in done:
                content['runs'].append(simulate(case, physics, frames))
                files.write_json(path, content)
    files.write_json(path, content)
    return content


def cases_of(content: dict) -> dict[int, dict]:
    """Returns the runs by case and physics, of the cases that have all."""
    found: dict[int, dict] = {}
    for run in content['runs']:
        found.setdefault(run['case'], {})[run['physics']] = run
    return {case: runs for case, runs in found.items() if runs.keys() == PHYSICS.keys()}


def table(path: str) -> str:
    """The table of a JSON of this report; forces are means over its frames."""
    content = files.read_json(path)
    rows, means = [], []
    for case, runs in cases_of(content).items():
        p = SCENE.parameters(case)
        x = [np.array(runs[name]['force_x_N']) for name in PHYSICS]
        y = [float(np.mean(runs[name]['force_y_N'])) for name in PHYSICS]
        published = content['records'].get(str(case))
        means.append([*(draft.mean() for draft in x), published['draft_N'] if published else 0.0])
        rows.append((
            case, f'{100 * p["depth_m"]:g}, {100 * p["speed_m_s"]:g}, {p["angle_deg"]:g}',
            *_drafts(*means[-1]), float(np.corrcoef(x[0], x[-1])[0, 1]),
            y[0], y[-1], published['vertical_N'] if published else '',
            ', '.join(f'{runs[name]["deepest_cells"]:.2f}' for name in PHYSICS),
            ', '.join(f'{runs[name]["cpu_s"]:.0f}' for name in PHYSICS),
        ))  # fmt: skip
    if len(rows) > 1 and all(mean[-1] for mean in means):
        rows.append(('**all**', '', *_drafts(*np.mean(means, axis=0))))
    header = ('case', 'depth cm, speed cm/s, lean', 'draft, ours, N', 'stiffness alone over it',
              'published physics over it', 'published record, N', 'ours over that',
              'published physics over that', 'its curve with ours, correlation',
              'vertical, ours, N', 'published physics, N', 'published record, N',
              'deepest particle, cells', 'CPU s')  # fmt: skip
    return markdown.table(header, rows)


def _drafts(ours, stiff, theirs, published) -> tuple:
    """Cells of four mean drafts (N); those of the published record blank where it is 0."""
    ours, stiff, theirs, published = map(float, (ours, stiff, theirs, published))
    cells = (ours, stiff / ours, theirs / ours)
    return (*cells, *((published, ours / published, theirs / published) if published else [''] * 3))


def draw(path: str, picture: str) -> None:
    """Draws the drafts of all cases, and the published means over `SPAN` frames."""
    from matplotlib import figure

    content = files.read_json(path)
    cases = cases_of(content)
    drawn = figure.Figure(figsize=(3.2 * len(cases), 3.2), layout='constrained')
    axes = drawn.subplots(1, len(cases), squeeze=False)
    time_s = np.arange(1, content['frames'] + 1) / scenes.FRAME_RATE
    for axis, (case, runs) in zip(axes[0], cases.items()):
        for name, colour in zip(PHYSICS, ('k', 'tab:orange', 'tab:red')):
            axis.plot(time_s, runs[name]['force_x_N'], color=colour, linewidth=1, label=name)
        if str(case) in content['records']:
            means = content['records'][str(case)]['draft_of_spans_N']
            edges = np.arange(len(means) + 1) * SPAN / scenes.FRAME_RATE
            axis.stairs(means, edges, color='tab:blue', label=f'record, {SPAN} frames')
        p = SCENE.parameters(case)
        title = f'{case}: {100 * p["depth_m"]:g} cm, {100 * p["speed_m_s"]:g} cm/s'
        axis.set(title=f'{title}, {p["angle_deg"]:g}°', xlabel='s', ylim=(0.0, None))
    axes[0, 0].set_ylabel('draft, N')
    axes[0, 0].legend(fontsize=7, frameon=False)
    files.write_atomically(picture, lambda name: drawn.savefig(name, format='png', dpi=110))


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('json', None, 'Where runs are kept; those there stay.', required=True)
    flags.DEFINE_list('cases', [str(case) for case in CASES], 'Cases of the excavation grid.')
    flags.DEFINE_integer('frames', 60, 'Frames of each run.', lower_bound=SPAN)
    flags.DEFINE_string('original_path', None, 'Published dataset folder (train and valid).')
    flags.DEFINE_string('picture_path', None, 'PNG of the forces.')


def main(values, _) -> None:
    """Runs the command."""
    cases = [int(case) for case in values.cases]
    measure(values.json, cases, values.frames, values.original_path)
    print(table(values.json))
    if values.picture_path:
        draw(values.json, values.picture_path)


if __name__ == '__main__':
    command.start(define_flags, main)
