"""Error against time on driven runs: what a method costs a frame, beside its errors.

The errors are those of a JSON of `reports.protocol`, test runs off the grid. Times are of a whole
rollout of one test run, all models in turns: until the load of all frames is there, and until
all particles are.

Examples:
    python -m reports driven_times --data_path=datasets/excavation_v2 \\
        --protocol=docs/protocol/excavation_v2.json \\
        --output_path=docs/protocol/excavation_v2_times \\
        --model=swept_field=models/excavation_v2/swept_field --model=mlp_driven=/tmp/mlp_driven_0
    python -m reports documents README.md     # the table, from the JSON
"""

import os

import numpy as np
from absl import flags

from mpm import scenes
from pca_tools import dataset, files
from reports import command, markdown, record, timing
from reports.protocol import driven_runs

SCHEMA_VERSION = 1
ROUNDS = 5
# What the solver takes for a run, by `reports.solver_speed`.
SOLVER_SPEED = os.path.join(record.ROOT, 'docs', 'solver', 'speed.json')
# Those that are drawn, as lines: a baseline's time is not taken, and more labels would overlap.
LINES = ('persistence', 'path ridge', 'earthmoving, fitted', 'Bekker-Wong-Janosi, fitted')


def time_models(data_path: str, models: dict[str, str], rounds: int = ROUNDS) -> dict:
    """Milliseconds of a frame, of each model.

    Args:
      data_path: dataset; the first test run that is not of the grid gives the path.
      models: name -> folder.
      rounds: calls of each, in turns.

    Returns:
      name -> `load_ms` and `particles_ms`, medians of CPU time.

    Raises:
      ValueError: no such run with poses.
    """
    import learning_to_simulate as lts

    cases = dataset.read_metadata(data_path).get('cases', {}).get('test', [])
    runs = dataset.read_split(data_path, 'test')
    other = driven_runs.GRID, 'disturbed'
    for run, case in zip(runs, cases, strict=False):
        if case.get('kind') not in other and run.rigid_pose is not None:
            poses, context = run.rigid_pose.astype(np.float64), run.step_context
            break
    else:
        raise ValueError(f'{data_path}: no test run on a flat bed, off the grid, with poses')
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
    timed = timing.in_turns(jobs, rounds)
    return {
        name: {
            f'{what}_ms': float(np.median(timed[f'{name} {what}'].processor_ms))
            for what in ('load', 'particles')
        }
        for name in models
    }


def table(times_path: str, protocol_path: str) -> str:
    """Errors of driven test runs and times of a frame, by method; mean (low to high) over seeds."""
    times = files.read_json(times_path)['models']
    errors = driven_runs.condense(files.read_json(protocol_path))[driven_runs.DRIVEN]
    names = list(dict.fromkeys(name for q in driven_runs.QUANTITIES for name in errors[q]))
    lines = []
    for name in names:
        shown = [markdown.span(errors[q].get(name, [])) for q in driven_runs.QUANTITIES]
        cost = times.get(name, {})
        lines.append((name, *shown, *(cost.get(f'{w}_ms', '') for w in ('load', 'particles'))))
    titles = driven_runs.QUANTITIES.values()
    runs = f'{errors["runs"]} driven test runs'
    return markdown.table((runs, *titles, 'load, ms a frame', 'all particles, ms a frame'), lines)


def solver_ms(scene: str) -> float:
    """Milliseconds of CPU that the solver takes for a frame of a scene."""
    rows = files.read_json(SOLVER_SPEED)['rows']
    seconds = next(row['this'] for row in rows if row['scene'] == scene)
    return 1e3 * float(np.median(seconds)) / (scenes.FRAMES - 1)


def draw(times_path: str, protocol_path: str, picture: str) -> None:
    """Soil against the time of a frame with all its particles, force against that of its load."""
    from matplotlib import figure

    times = files.read_json(times_path)['models']
    document = files.read_json(protocol_path)
    errors = driven_runs.condense(document)[driven_runs.DRIVEN]
    drawn = figure.Figure(figsize=(9, 3.8), layout='constrained')
    pairs = zip(driven_runs.QUANTITIES.items(), ('particles_ms', 'load_ms'), strict=True)
    for axes, ((quantity, title), clock) in zip(drawn.subplots(1, 2), pairs, strict=True):
        for name, seeds in errors[quantity].items():
            mean, low, high = np.mean(seeds), min(seeds), max(seeds)
            if name in times:
                number = list(times).index(name)
                axes.errorbar(
                    times[name][clock], mean, [[mean - low], [high - mean]], fmt='o', capsize=3,
                    color=f'C{number}', label=name,
                )  # fmt: skip
            elif name in LINES:
                axes.axhline(mean, color='0.6', lw=1, ls='--')
                axes.annotate(
                    name, (1.0, mean), xycoords=('axes fraction', 'data'), fontsize='small',
                    ha='right', va='bottom', color='0.4',
                )  # fmt: skip
        solver = solver_ms(document['scene'])
        axes.axvline(solver, color='0.8', lw=1)
        axes.annotate(
            'solver', (solver, 0.02), xycoords=('data', 'axes fraction'), fontsize='small',
            ha='right', color='0.4',
        )  # fmt: skip
        of = 'with all particles' if clock == 'particles_ms' else 'without particles'
        axes.set(xscale='log', xlabel=f'ms a frame, {of}, one thread', ylabel=title)
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
        axes.legend(frameon=False, fontsize='small')
    drawn.suptitle(f'{errors["runs"]} driven test runs, mean and range of seeds', fontsize='small')
    files.write_atomically(picture, lambda name: drawn.savefig(name, format='png', dpi=130))


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('data_path', None, 'Dataset of the paths.', required=True)
    flags.DEFINE_string('protocol', None, 'JSON of `reports.protocol` on it.', required=True)
    flags.DEFINE_multi_string('model', None, 'NAME=FOLDER, as in the protocol.', required=True)
    flags.DEFINE_string('output_path', None, 'Path of .json and .png, without it.', required=True)
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
    path = f'{values.output_path}.json'
    files.write_json(
        path,
        {
            'schema_version': SCHEMA_VERSION,
            **record.provenance(values.num_threads),
            'models': time_models(values.data_path, models),
        },
    )
    draw(path, values.protocol, f'{values.output_path}.png')
    print(table(path, values.protocol))


if __name__ == '__main__':
    command.start(define_flags, main)
