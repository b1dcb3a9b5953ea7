"""Scenes of every kind: data of our solver, a model trained a little, and what each costs.

Every scene is simulated (coarse cells, nine runs), converted, trained with one small recipe, rolled
out, drawn and exported. Errors are RMS per coordinate in full space, truncation error included, of
each test run beside persistence (the soil stays as it is). Times are of whole rollouts of a run on
one thread, all scenes in turns in one process; only their ratios mean anything on a busy machine.

Examples:
    python -m reports scenes --output_path=/tmp/scenes
    python -m reports scenes --output_path=/tmp/scenes --scenes=column,pair  # goes on
    python -m reports scenes --output_path=/tmp/scenes63 --scenes=pair --data_runs=63
"""

import functools
import os

from absl import flags

import learning_to_simulate as lts
from learning_to_simulate import render_rollout
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH
from pca_tools import convert, files, write_raw
from reports import command, markdown, record, timing
from reports.scenes import runs

# What `write_raw` and `convert` must know of each scene, and what it shows.
SCENES: dict[str, dict] = {
    'column': {'dt': 1 / 120, 'modes': 8},
    'column_2d': {'dt': 1 / 90, 'modes': 6},
    'lengths': {'dt': 1 / 120, 'modes': 8},
    'widths': {'dt': 1 / 60, 'modes': 8},
    'load': {'dt': 1 / 60, 'modes': 5, 'body': 'driven'},
    'pair': {'dt': 1 / 60, 'modes': 10, 'bodies': [
        {'name': 'blade', 'rigid_motion': 'prescribed', 'points': 20},
        {'name': 'wheel', 'rigid_motion': 'prescribed', 'points': 16},
    ]},
}  # fmt: skip
MODE_EDGES = 28  # of `pcg`; few modes have fewer
RECIPE = {
    'latent_size': 32, 'rigid_particles': 0, 'num_steps': 1500, 'decay_steps': 750,
    'unroll_steps': 200, 'unroll_length': 4, 'unroll_batch_size': 16,
}  # fmt: skip
PARTS = 'model', 'exported', 'rollouts'
BASE = 'widths'  # the scene of one blade, whose time is 1


def make(folder: str, name: str, num_runs: int = len(runs.SPLITS)) -> lts.Dataset:
    """Simulates and converts so many runs of a scene, unless its dataset is there."""
    options = dict(SCENES[name])
    modes, dt = options.pop('modes'), options.pop('dt')
    raw, data = (os.path.join(folder, name, part) for part in ('raw', 'data'))
    if not os.path.exists(os.path.join(data, 'metadata.json')):
        if not os.path.exists(os.path.join(raw, 'manifest.json')):
            made = (getattr(runs, name)(run) for run in range(num_runs))
            write_raw(raw, made, dt, up_axis='y', name=name, gravity=(0, -9.81, 0), **options)
        convert.convert(raw, data, modes=modes)
    return lts.Dataset(data)


def preset(name: str, recipe: dict = RECIPE):
    """The config of a scene's model."""
    edges = min(MODE_EDGES, SCENES[name]['modes'] ** 2)
    return lts.preset('pcg', mode_edges=edges, **recipe)


def judge(folder: str, name: str) -> dict:
    """One row: trains, rolls out, draws and exports a scene.

    Raises:
      ValueError, OSError: of the parts.
    """
    from learning_to_simulate import evaluation

    data = make(folder, name)
    path, exported, pictures = (os.path.join(folder, name, x) for x in PARTS)
    model = lts.train(preset(name), data, path)
    opened = _opened(path, data.path)
    results, summary = opened.evaluator.run(opened.groups, 'test')
    written = evaluation.save_rollouts(pictures, 'test', results, summary, data.metadata)
    render_rollout.render(written[0], data.path, pictures, ['png'])
    if not os.path.exists(os.path.join(exported, 'export.json')):
        model.export(exported, data)
    scene, rows = model.scene, summary['runs']
    counts = {run.n_rigid for run in data.train.records}
    layouts = [model.model.layout(n) for n in sorted({g.n_rigid for g in opened.groups})]
    return {
        'bodies': len(scene.bodies) or int(counts != {0}),
        'rigid_points': sorted(counts),
        'dim': data.metadata['scene'].get('dim', 3),
        'frames': sorted({run.n_frames for run in data.train.records}),
        'frame_rate': round(1 / scene.dt, 3),
        'modes': scene.n_modes,
        'particles': scene.n_soil,
        'force': scene.has_force,
        'context': list(scene.context_names),
        'soil_rms_mm': [row['soil_rms_mm_full'] for row in rows['model']],
        'persistence_rms_mm': [row['soil_rms_mm_full'] for row in rows['stay_still']],
        'truncation_rms_mm': 1e3 * summary['projection_mse'] ** 0.5,
        'force_relative_l2': [row.get('force_relative_l2') for row in rows['model']],
        'persistence_force': [row.get('force_relative_l2') for row in rows['stay_still']],
        'weights': sum(v.shape.num_elements() for v in model.model.simulator.variables),
        'edges': [layout.n_edge for layout in layouts],
        'edges_left_out': [layout.n_node**2 - layout.n_edge for layout in layouts],
        'status': [row['status'] for row in rows['model']],
    }


@functools.cache
def _opened(model_path, data_path):
    """The model with its test runs; its rollouts are compiled once."""
    from learning_to_simulate.methods import subspace_method

    return subspace_method.open_model(model_path, data_path, 'test')


def times(folder: str, names, rounds: int) -> dict[str, float]:
    """Median ms a step of one test run of each scene, rolled out in turns."""
    jobs = {}
    for name in names:
        opened = _opened(*(os.path.join(folder, name, part) for part in ('model', 'data')))
        group = opened.groups[0].select(0)

        def call(evaluator=opened.evaluator, group=group):
            return evaluator.roll_out(group).seconds

        jobs[name] = timing.Job(call, steps=group.position.shape[1] - INPUT_SEQUENCE_LENGTH)
    return {name: t.percentile(50) for name, t in timing.in_turns(jobs, rounds, 'rollouts').items()}


def table(path: str) -> str:
    """The table of the report from its JSON."""
    rows = files.read_json(path)['rows']
    base = rows.get(BASE, {}).get('ms_per_step')

    def plain(values):
        return ', '.join(map(str, values)) or 'no'

    return markdown.table(
        (
            'scene', 'bodies: points', 'particles, modes', 'frames at 1/s', 'force, context',
            'soil RMS mm: each test run', 'persistence', 'truncation',
            'force rel. L2', 'last force held', f'step time / {BASE}', 'weights', 'edges',
            'edges left out',
        ),
        (
            (
                f'`{name}`' + (' (2-D)' if row['dim'] == 2 else ''),
                f'{row["bodies"]}: {plain(row["rigid_points"])}' if row['bodies'] else 'none',
                f'{row["particles"]}, {row["modes"]}',
                f'{plain(row["frames"])} at {row["frame_rate"]:g}',
                f'{"yes" if row["force"] else "no"}, {plain(row["context"])}',
                *(_runs(row[k]) for k in ('soil_rms_mm', 'persistence_rms_mm')),
                row['truncation_rms_mm'],
                *(_runs(row[k]) for k in ('force_relative_l2', 'persistence_force')),
                row['ms_per_step'] / base if base and 'ms_per_step' in row else None,
                row['weights'],
                plain(row['edges']),
                plain(row['edges_left_out']),
            )
            for name, row in rows.items()
        ),
    )  # fmt: skip


def _runs(values):
    return ', '.join(markdown.cell(v) for v in values if v is not None)


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_list('scenes', list(SCENES), 'Which scenes.')
    flags.DEFINE_integer('data_runs', 0, 'Only make datasets of so many runs, SCENE/data each.', 0)
    flags.DEFINE_integer('rounds', 21, 'Timed rollouts of each scene.', 1)
    flags.DEFINE_integer('num_threads', 1, 'CPU threads.', 1)
    flags.DEFINE_string('output_path', None, 'Folder for data and models.', required=True)
    flags.DEFINE_string('json_path', None, 'JSON of the rows; default: in the folder.')


def run(values, _) -> None:
    """Runs the report.

    Raises:
      ValueError: an unknown scene.
    """
    if unknown := set(values.scenes) - set(SCENES):
        raise ValueError(f'unknown scenes {sorted(unknown)}; there are {", ".join(SCENES)}')
    if values.data_runs:
        for name in values.scenes:
            print(make(values.output_path, name, values.data_runs).path)
        return
    target = values.json_path or os.path.join(values.output_path, 'scenes.json')
    document = record.resume(target, {'recipe': RECIPE}, {'rows': {}})
    for name in values.scenes:
        if name not in document['rows']:
            document['rows'][name] = judge(values.output_path, name)
            files.write_json(target, document | record.provenance(values.num_threads))
            print(f'{name}: {document["rows"][name]}', flush=True)
    document['rows'] = {name: document['rows'][name] for name in SCENES if name in document['rows']}
    for name, ms in times(values.output_path, document['rows'], values.rounds).items():
        document['rows'][name]['ms_per_step'] = ms
    files.write_json(target, document | record.provenance(values.num_threads))
    print(table(target))


if __name__ == '__main__':
    command.start(define_flags, run)
