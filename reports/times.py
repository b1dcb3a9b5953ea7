"""Error against run time on driven test runs: what a frame of each method costs, beside its errors.

The errors are those of a JSON of `reports protocol`, test runs that are driven freely. The times
are those of one such run, on one thread, all models in turns: of a whole rollout until the load of
every frame is there, and until every particle is; of live steps from Python, one by one. What the
solver took for its runs stands in the dataset.

Examples:
    python -m reports times --data_path=datasets/excavation_v2 \\
        --protocol=docs/protocol/excavation_v2.json --output_path=docs/times \\
        --model=swept_field=models/excavation_v2/swept_field --model=mlp_driven=/tmp/mlp_driven_0

    python -m reports documents docs/results.md     # the table again, from the JSON
"""

import functools

import numpy as np
from absl import flags

from learning_to_simulate.command import named_paths
from pca_tools import dataset, files
from reports import command, markdown, record, timing
from reports.protocol import over_runs, tables

SCHEMA_VERSION = 3
QUANTITIES = 'soil_mm', 'force_l2'
ROUNDS = 5
# Drawn as lines, where the protocol has them: nobody waits for a baseline.
LINES = ('persistence', 'path ridge', 'earthmoving, fitted', 'Bekker-Wong-Janosi, fitted')
COLUMNS = {
    'load_ms': 'load, ms a frame',
    'particles_ms': 'all particles, ms a frame',
    'step_ms': 'live step, ms',
    'step_p99_ms': '99 %',
}


def time_models(data_path: str, models: dict[str, str], rounds: int = ROUNDS) -> dict:
    """Milliseconds of a frame, of each model.

    Args:
      data_path: dataset; the first driven test run on a flat bed gives the path.
      models: name -> folder.
      rounds: calls of each, in turns.

    Returns:
      name -> the keys of `COLUMNS`: medians over calls (CPU time of whole rollouts), and of live
      steps the 99th percentile as well.

    Raises:
      ValueError: no such run with poses.
    """
    import learning_to_simulate as lts

    poses, contexts = _driven_path(data_path)
    jobs = {}
    for name, folder in models.items():
        model = lts.load(folder)

        def loads(model=model):
            return model.rollout(poses, context=contexts)

        def particles(loads=loads):
            rollout = loads()
            for frame in range(len(rollout)):
                rollout.particles(frame)

        def steps(live):
            return timing.stepping(live, poses, contexts)[0]

        n_frame = len(poses) - 1
        jobs[name, 'load'] = timing.Job(loads, n_frame)
        jobs[name, 'particles'] = timing.Job(particles, n_frame)
        jobs[name, 'step'] = timing.Job(functools.partial(steps, model.stepper()))
    timed = timing.in_turns(jobs, rounds)
    return {
        name: {
            'load_ms': float(np.median(timed[name, 'load'].processor)),
            'particles_ms': float(np.median(timed[name, 'particles'].processor)),
            'step_ms': float(np.median(timed[name, 'step'].clock)),
            'step_p99_ms': float(np.percentile(timed[name, 'step'].clock, 99)),
        }
        for name in models
    }


def _runs(data_path):
    """(run, case) of each test run whose case is stated."""
    cases = dataset.read_metadata(data_path).get('cases', {}).get('test', [])
    return list(zip(dataset.read_split(data_path, 'test'), cases, strict=False))


def _driven_path(data_path):
    """Poses and contexts of the first test run on a flat bed, off the grid."""
    for run, case in _runs(data_path):
        if case.get('kind') not in (over_runs.GRID, 'disturbed') and run.rigid_pose is not None:
            return run.rigid_pose.astype(np.float64), run.step_context
    raise ValueError(f'{data_path}: no test run on a flat bed, off the grid, with poses')


def solver_ms(data_path: str) -> float | None:
    """Milliseconds of CPU of a frame of the solver, median over the runs; None if not stated."""
    known = [
        1e3 * case['solver_cpu_s'] / (run.n_frames - 1)
        for run, case in _runs(data_path)
        if 'solver_cpu_s' in case
    ]
    return float(np.median(known)) if known else None


def rows(times: dict, protocol: dict) -> tuple[list[dict], int]:
    """Everything that has an error, and how many driven runs the protocol has.

    Args:
      times: JSON of this report.
      protocol: JSON of `reports protocol`.

    Returns:
      dicts of `name`, `soil_mm` and `force_l2` (one value a seed) and the times that were taken.
      Another form of a method, named 'METHOD, in C', has its errors.
    """
    errors = over_runs.condense(protocol)[over_runs.DRIVEN]
    found = []
    for name in dict.fromkeys(name for q in QUANTITIES for name in errors[q]):
        of_method = {q: errors[q].get(name, []) for q in QUANTITIES}
        forms = [n for n in times['models'] if n in (name, f'{name}, in C')]
        for form in forms or [name]:
            found.append({'name': form} | of_method | times['models'].get(form, {}))
    return found, errors['runs']


def table(times_path: str, protocol_path: str) -> str:
    """Errors of driven test runs and times of a frame, by method; mean (low to high) over seeds."""
    found, runs = rows(files.read_json(times_path), files.read_json(protocol_path))
    columns = [key for key in COLUMNS if any(key in row for row in found)]
    lines = [
        (row['name'], *(markdown.span(row[q]) for q in QUANTITIES))
        + tuple(row.get(key) for key in columns)
        for row in found
    ]
    header = (f'{runs} driven test runs', *(tables.TITLES[q] for q in QUANTITIES))
    return markdown.table((*header, *(COLUMNS[key] for key in columns)), lines)


def draw(times_path: str, protocol_path: str, picture: str) -> None:
    """Soil against the time of a frame with all its particles, force against that of its load."""
    from matplotlib import figure

    times = files.read_json(times_path)
    found, runs = rows(times, files.read_json(protocol_path))
    drawn = figure.Figure(figsize=(10, 4.6), layout='constrained')
    panels = zip(drawn.subplots(1, 2), QUANTITIES, ('particles_ms', 'load_ms'), strict=True)
    for axes, error, clock in panels:
        for row in (row for row in found if clock in row):
            seeds = np.array(row[error])
            spread = [[seeds.mean() - seeds.min()], [seeds.max() - seeds.mean()]]
            axes.errorbar(
                row[clock], seeds.mean(), spread, fmt='o', ms=5, capsize=3, label=row['name']
            )
        lines = [row for row in found if row['name'] in LINES and row[error]]
        for name, height in ((row['name'], np.mean(row[error])) for row in lines):
            axes.axhline(height, color='0.6', lw=1, ls='--')
            place = {'xycoords': ('axes fraction', 'data'), 'ha': 'center', 'va': 'bottom'}
            axes.annotate(name, (0.5, height), fontsize='small', color='0.4', **place)
        if times.get('solver_ms'):
            axes.axvline(times['solver_ms'], color='0.8', lw=1, label='solver')
        of = 'with all particles' if clock == 'particles_ms' else 'force only'
        axes.set(xscale='log', xlabel=f'ms a frame, {of}, one thread')
        axes.set_ylabel(tables.TITLES[error])
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
    handles, labels = axes.get_legend_handles_labels()
    drawn.legend(handles, labels, loc='outside lower center', ncols=4, fontsize='small')
    drawn.suptitle(f'{runs} driven test runs: mean and range of trainings')
    files.write_atomically(picture, lambda name: drawn.savefig(name, format='png', dpi=130))


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('data_path', None, 'Dataset of the paths.', required=True)
    flags.DEFINE_string('protocol', None, 'JSON of `reports protocol` on it.', required=True)
    flags.DEFINE_multi_string('model', None, 'NAME=FOLDER, as in the protocol.', required=True)
    flags.DEFINE_string('output_path', None, 'Path of .json and .png, without it.', required=True)
    flags.DEFINE_integer('num_threads', 1, 'Threads of TensorFlow.', lower_bound=1)


def main(values, _) -> None:
    """Runs the command."""
    models = named_paths('model', values.model, 'FOLDER')
    methods = {m['name'] for m in files.read_json(values.protocol)['methods']}
    if unknown := sorted(models.keys() - methods):
        raise ValueError(f'--model: {values.protocol} judges {sorted(methods)}, no {unknown}')
    path = f'{values.output_path}.json'
    found = {
        'schema_version': SCHEMA_VERSION,
        **record.provenance(values.num_threads),
        'solver_ms': solver_ms(values.data_path),
        'models': time_models(values.data_path, models),
    }
    files.write_json(path, found)
    draw(path, values.protocol, f'{values.output_path}.png')
    print(table(path, values.protocol))


if __name__ == '__main__':
    command.start(define_flags, main)
