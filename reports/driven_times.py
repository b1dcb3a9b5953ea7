"""Error against time on driven runs: what a method costs a frame, beside its errors.

The errors are those of a JSON of `reports.protocol`, test runs off the grid. Times are of a whole
rollout of one test run, all models in turns: until the load of all frames is there, and until
all particles are. Beside them the solver on coarser cells, on some of the same runs.

Examples:
    python -m reports driven_times --data_path=datasets/excavation_v2 \\
        --protocol=docs/protocol/excavation_v2.json \\
        --solver_json=docs/coarse_solver_driven.json --in_c=swept_field \\
        --output_path=docs/protocol/excavation_v2_times \\
        --model=swept_field=models/excavation_v2/swept_field --model=mlp_driven=/tmp/mlp_driven_0
    python -m reports documents README.md     # the table, from the JSON
"""

import os
import re

import numpy as np
from absl import flags

from mpm import scenes
from pca_tools import dataset, files
from reports import command, markdown, record, timing
from reports.protocol import driven_runs
from reports.work_precision import solver_rows

SCHEMA_VERSION = 2
ROUNDS = 5
IN_C = ', in C'  # after the name of a model whose C export is timed
# What the solver takes for a run, by `reports.solver_speed`.
SOLVER_SPEED = os.path.join(record.ROOT, 'docs', 'solver', 'speed.json')
# Those that are drawn, as lines: a baseline's time is not taken, and more labels would overlap.
LINES = ('persistence', 'path ridge', 'earthmoving, fitted', 'Bekker-Wong-Janosi, fitted')


def time_models(
    data_path: str, models: dict[str, str], in_c: tuple = (), rounds: int = ROUNDS
) -> dict:
    """Milliseconds of a frame, of each model.

    Args:
      data_path: dataset; the first test run that is not of the grid gives the path.
      models: name -> folder.
      in_c: names of swept fields among them whose C code is timed as well.
      rounds: calls of each, in turns.

    Returns:
      name -> `load_ms` and `particles_ms`, medians of CPU time.

    Raises:
      ValueError: no such run with poses.
    """
    import learning_to_simulate as lts
    from learning_to_simulate.export_c.c_field import CField

    poses, context = _driven_path(data_path)
    jobs = {}
    for name, folder in models.items():
        model = lts.load(folder)

        def loads(model=model):
            return model.rollout(poses, context=context)

        def particles(model=model):
            rollout = model.rollout(poses, context=context)
            for frame in range(len(rollout.modes)):
                rollout.particles(frame)

        n_frame = len(loads().modes)
        jobs[f'{name} load'] = timing.Job(loads, n_frame)
        jobs[f'{name} particles'] = timing.Job(particles, n_frame)
    for name in in_c:
        field = CField.load(models[name])

        def steps(field=field, with_particles=False):
            field.start(poses[0])
            for pose in poses[1:]:
                field.step(pose)
                if with_particles:
                    field.particles()

        def all_particles(steps=steps):
            steps(with_particles=True)

        jobs[f'{name}{IN_C} load'] = timing.Job(steps, len(poses) - 1)
        jobs[f'{name}{IN_C} particles'] = timing.Job(all_particles, len(poses) - 1)
    timed = timing.in_turns(jobs, rounds)
    return {
        name: {
            f'{what}_ms': float(np.median(timed[f'{name} {what}'].processor_ms))
            for what in ('load', 'particles')
        }
        for name in (*models, *(f'{name}{IN_C}' for name in in_c))
    }


def _driven_path(data_path):
    """Poses and contexts of the first test run on a flat bed, off the grid."""
    cases = dataset.read_metadata(data_path).get('cases', {}).get('test', [])
    runs = dataset.read_split(data_path, 'test')
    other = driven_runs.GRID, 'disturbed'
    for run, case in zip(runs, cases, strict=False):
        if case.get('kind') not in other and run.rigid_pose is not None:
            return run.rigid_pose.astype(np.float64), run.step_context
    raise ValueError(f'{data_path}: no test run on a flat bed, off the grid, with poses')


def rows(times: dict, protocol: dict) -> tuple[list[tuple], int]:
    """Everything that has an error, and how many driven runs the protocol has.

    Args:
      times: JSON of this report.
      protocol: JSON of `reports.protocol`.

    Returns:
      (name, soil error of each seed, force error of each seed, time of the load, of all particles;
      None where it was not taken), methods of the protocol first, then the solver's.
    """
    errors = driven_runs.condense(protocol)[driven_runs.DRIVEN]
    found = []
    names = list(dict.fromkeys(name for q in driven_runs.QUANTITIES for name in errors[q]))
    for name in names:
        seeds = [errors[q].get(name, []) for q in driven_runs.QUANTITIES]
        for timed in (name, f'{name}{IN_C}'):
            cost = times['models'].get(timed, {})
            if cost or timed == name:
                found.append((timed, *seeds, cost.get('load_ms'), cost.get('particles_ms')))
    for name, row in times.get('solver', {}).items():
        ms = row['ms']  # soil and force come together
        found.append((name, [row['soil_mm']], [row['force_l2']], ms, ms))
    return found, errors['runs']


def table(times_path: str, protocol_path: str) -> str:
    """Errors of driven test runs and times of a frame, by method; mean (low to high) over seeds."""
    found, runs = rows(files.read_json(times_path), files.read_json(protocol_path))
    lines = [
        (name, markdown.span(soil), markdown.span(force), load, particles)
        for name, soil, force, load, particles in found
    ]
    titles = driven_runs.QUANTITIES.values()
    header = (f'{runs} driven test runs', *titles, 'load, ms a frame', 'all particles, ms a frame')
    return markdown.table(header, lines)


def solver_ms(scene: str) -> float:
    """Milliseconds of CPU that the solver takes for a frame of a scene."""
    rows = files.read_json(SOLVER_SPEED)['rows']
    seconds = next(row['this'] for row in rows if row['scene'] == scene)
    return 1e3 * float(np.median(seconds)) / (scenes.FRAMES - 1)


def draw(times_path: str, protocol_path: str, picture: str) -> None:
    """Soil against the time of a frame with all its particles, force against that of its load.

    Points that differ in the number of modes alone are joined by a line.
    """
    from matplotlib import figure

    protocol = files.read_json(protocol_path)
    found, runs = rows(files.read_json(times_path), protocol)
    drawn = figure.Figure(figsize=(10, 4.6), layout='constrained')
    timed = [row for row in found if row[4] is not None]
    groups: dict[str, list] = {}
    for row in timed:
        groups.setdefault(re.sub(r', \d+ modes$', '', row[0]), []).append(row)
    places = zip(drawn.subplots(1, 2), driven_runs.QUANTITIES.values(), (1, 2), (4, 3), strict=True)
    for axes, title, error, clock in places:
        for number, (group, members) in enumerate(groups.items()):
            members = sorted(members, key=lambda row: row[clock])
            x = [row[clock] for row in members]
            mean, low, high = np.array(
                [(np.mean(row[error]), min(row[error]), max(row[error])) for row in members]
            ).T
            style = 's' if group.startswith('solver') else 'o'
            axes.errorbar(
                x, mean, [mean - low, high - mean], fmt=f'{style}-', lw=1, ms=5, capsize=3,
                color=f'C{number % 10}', label=group if len(members) > 1 else members[0][0],
            )  # fmt: skip
            for row, at, height in zip(members, x, mean, strict=True):
                if len(members) > 1 and (modes := re.search(r', (\d+) modes$', row[0])):
                    axes.annotate(
                        modes[1], (at, height), xytext=(4, 4), textcoords='offset points',
                        fontsize='x-small', color=f'C{number % 10}',
                    )  # fmt: skip
        for row in found:
            if row[0] in LINES and row[error]:
                mean = np.mean(row[error])
                axes.axhline(mean, color='0.6', lw=1, ls='--')
                axes.annotate(
                    row[0], (0.5, mean), xycoords=('axes fraction', 'data'), fontsize='small',
                    ha='center', va='bottom', color='0.4',
                )  # fmt: skip
        solver = solver_ms(protocol['scene'])
        axes.axvline(solver, color='0.8', lw=1)
        axes.annotate(
            'solver', (solver, 0.02), xycoords=('data', 'axes fraction'), fontsize='small',
            ha='right', color='0.4',
        )  # fmt: skip
        of = 'with all particles' if clock == 4 else 'without particles'
        axes.set(xscale='log', xlabel=f'ms a frame, {of}, one thread', ylabel=title)
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
    handles, labels = axes.get_legend_handles_labels()
    drawn.legend(handles, labels, loc='outside lower center', ncols=4, fontsize='small')
    drawn.suptitle(
        f'{runs} driven test runs, mean and range of seeds; numbers: modes', fontsize='small'
    )
    files.write_atomically(picture, lambda name: drawn.savefig(name, format='png', dpi=130))


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('data_path', None, 'Dataset of the paths.', required=True)
    flags.DEFINE_string('protocol', None, 'JSON of `reports.protocol` on it.', required=True)
    flags.DEFINE_multi_string('model', None, 'NAME=FOLDER, as in the protocol.', required=True)
    flags.DEFINE_string('output_path', None, 'Path of .json and .png, without it.', required=True)
    flags.DEFINE_multi_string('in_c', [], 'Swept field of --model that is timed in C as well.')
    flags.DEFINE_string('solver_json', None, 'Rows of `reports coarse_solver` on driven runs.')
    flags.DEFINE_integer('num_threads', 1, 'Threads of TensorFlow.', lower_bound=1)


def main(values, _) -> None:
    """Runs the command."""
    models = dict(item.partition('=')[::2] for item in values.model)
    methods = {m['name'] for m in files.read_json(values.protocol)['methods']}
    if unknown := [n for n, folder in models.items() if n not in methods or not folder]:
        raise ValueError(
            f'--model: NAME=FOLDER with a method of {values.protocol} was expected, got {unknown}; '
            f'it has {sorted(methods)}'
        )
    if unknown := sorted(set(values.in_c) - models.keys()):
        raise ValueError(f'--in_c: names of --model were expected, got {unknown}')
    solver = solver_rows.means(values.solver_json) if values.solver_json else {}
    path = f'{values.output_path}.json'
    files.write_json(
        path,
        {
            'schema_version': SCHEMA_VERSION,
            **record.provenance(values.num_threads),
            'models': time_models(values.data_path, models, tuple(values.in_c)),
            'solver': solver,
        },
    )
    draw(path, values.protocol, f'{values.output_path}.png')
    print(table(path, values.protocol))


if __name__ == '__main__':
    command.start(define_flags, main)
