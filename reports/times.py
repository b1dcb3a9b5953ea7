"""Error against run time: what a frame of each method costs, beside its errors.

All times are of the path of one driven test run, on one thread, all methods in turns: of the force
of a frame, and of the force and all particles that the networks' dataset follows. Whole rollouts by
TensorFlow; in C step by step from Python. The solver's time is given, or is that of the dataset,
which another processor may have made. Errors are the means of a JSON of `reports protocol`; those
of fewer members of a soil field are taken here.

Examples:
    python -m reports times --data_path=datasets/excavation \\
        --protocol=docs/protocol/excavation.json \\
        --soil_field=models/excavation/soil_field --model=pcg=models/excavation/pcg \\
        --training_s='soil field=5000' --output_path=docs/times

    # what tells the force, or all particles, best within half a millisecond a frame
    python -m reports times --budget_ms=0.5 --output_path=docs/times
"""

import functools
import os
import re

import numpy as np
from absl import flags

import learning_to_simulate as lts
from learning_to_simulate import registry
from learning_to_simulate.command import named_paths
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from pca_tools import dataset, files
from pca_tools.subspace import Subspace
from reports import markdown, record, timing
from reports.protocol import judge, tables

SCHEMA_VERSION = 5
QUANTITIES = 'soil_mm', 'force_relative_l2'
ROUNDS, FRAMES = 5, 150
NOT_OPERATOR = 'grid', 'disturbed'  # kinds of runs that are not driven from a flat bed
SOIL_FIELD = 'soil field'
# Drawn as lines, where the protocol has them: nobody waits for a baseline.
LINES = ('persistence', 'earthmoving', 'Bekker-Wong-Janosi')


def driven(data_path: str) -> int:
    """The record of the first test run that is driven from a flat bed; ValueError without one."""
    for number, case in enumerate(_cases(data_path, 'test')):
        if case.get('kind') not in NOT_OPERATOR:
            return number
    raise ValueError(f'{data_path}: no test run that is driven from a flat bed')


def _cases(data_path, split):
    return dataset.read_metadata(data_path)['cases'].get(split, [])


def runs_s(data_path: str) -> float:
    """Seconds of CPU that the solver took for the runs of train and valid, of datasets separated by
    commas."""
    folders = data_path.split(',')
    cases = [c for f in folders for split in ('train', 'valid') for c in _cases(f, split)]
    return float(sum(case.get('solver_cpu_s', 0.0) for case in cases))


def solver_ms(data_path: str) -> float:
    """Milliseconds of CPU of a frame of the solver, median over the runs that state it."""
    runs = dataset.read_split(data_path, 'test')
    known = [
        1e3 * case['solver_cpu_s'] / (run.n_frames - 1)
        for run, case in zip(runs, _cases(data_path, 'test'), strict=True)
        if 'solver_cpu_s' in case
    ]
    return float(np.median(known))


def field_jobs(folder: str, data_path: str) -> tuple[dict, dict]:
    """Of a soil field with 1 .. M members, in C and by TensorFlow: (name, what) -> `timing.Job`;
    and name -> mean errors, of those with fewer members than all."""
    from learning_to_simulate.native.engines import TENSORFLOW, C
    from learning_to_simulate.soil_field import evaluation, method
    from learning_to_simulate.soil_field.stepper import SoilStepper

    opened = method.open_model(folder, data_path, 'test')
    field, run = opened.model, opened.groups[driven(data_path)]
    points = Subspace.load(os.path.join(data_path, 'subspace.npz')).initial
    path = run.pose[:FRAMES]
    jobs, errors = {}, {}

    def steps(members, engine, has_particles):
        stepper = SoilStepper(field, run.before(), run.tool, members, engine)
        stepper.start(path[0], points if has_particles else None)
        given = [{'dt': run.dt}] * (len(path) - 1)
        return timing.steps(stepper, path[1:], given, has_particles)

    for members in range(1, field.networks.members + 1):
        for engine, where in ((C, 'C'), (TENSORFLOW, 'TensorFlow')):
            name = f'{SOIL_FIELD}, {members} of {field.networks.members} members, {where}'
            for what, has_particles in (('load', False), ('particles', True)):
                call = functools.partial(steps, members, engine, has_particles)
                jobs[name, what] = timing.Job(call)
            if members < field.networks.members:
                if engine == C:
                    judge = evaluation.SoilEvaluator(field, members, under_load=False)
                    mean = judge.run(opened.groups, 'test')[1]['mean']['model']
                errors[name] = {key: mean[key] for key in QUANTITIES}
    return jobs, errors


def subspace_jobs(name: str, folder: str, data_path: str) -> dict:
    """Of a method in the subspace: (name, what) -> `timing.Job`; in C where it has that form."""
    opened = registry.open_model(folder, data_path, 'test')
    number, space = driven(data_path), Subspace.load(os.path.join(data_path, 'subspace.npz'))
    group = next(
        g.select(i) for g in opened.groups for i in range(len(g.position)) if g.record[i] == number
    )

    def roll_out(has_particles):
        rollout = opened.evaluator.roll_out(group)
        if has_particles:
            modes = group.with_left_modes(rollout.position)[0, :, group.n_rigid :]
            for frame in modes:
                space.components[:, : len(frame)] @ frame + space.mean

    steps = registry.of_folder(folder).steps
    where, count = 'TensorFlow' if steps else 'NumPy', group.position.shape[1] - H
    forms = {where: (roll_out, count)}
    live = lts.load(folder).stepper() if steps else None
    if live is not None and live.engine.startswith('C '):
        run = dataset.read_split(data_path, 'test')[number]
        poses = np.asarray(run.rigid_pose, np.float64)[:FRAMES]
        forms['C'] = functools.partial(timing.stepping, live, poses, run.step_context), 1
    return {
        (f'{name}, {where}', what): timing.Job(functools.partial(call, what == 'particles'), count)
        for where, (call, count) in forms.items()
        for what in ('load', 'particles')
    }


def measured(data_path: str, field: str, models: dict[str, str], protocol: dict) -> list[dict]:
    """Rows of the table: `name`, `QUANTITIES` (one value a training), `load_ms`, `particles_ms`."""
    jobs, errors = field_jobs(field, data_path)
    for name, folder in models.items():
        jobs |= subspace_jobs(name, folder, data_path)
    timed = timing.in_turns(jobs, ROUNDS)
    rows = []
    for name in dict.fromkeys(name for name, _ in jobs):
        own = protocol['summary']['all'].get(name.split(', ')[0], {})
        row = {'name': name}
        for key in QUANTITIES:
            given = [errors[name][key]] if name in errors else own.get(key, {}).get('mean', [])
            row[key] = [record.four(error) for error in given if error is not None]
        for what in ('load', 'particles'):
            found = timed[name, what]
            # CPU time of whole rollouts: on a busy machine it says more.
            sample = found.processor if len(found.processor) else found.clock
            row[f'{what}_ms'] = record.four(np.median(sample))
        rows.append(row)
    return rows


def table(path: str) -> str:
    """Errors and times of a frame, and how many times faster than the solver; from the JSON."""
    found = files.read_json(path)
    solver = found['solver_ms']
    lines: list[tuple] = [('solver', '', '', solver, solver, 1)]
    for row in found['rows']:
        members = re.search(r'(\d+) of (\d+) members, TensorFlow', row['name'])
        if members and members[1] != members[2]:
            continue  # who wants it faster takes C
        cells = (markdown.mean(row[key]) for key in QUANTITIES)
        times = row['load_ms'], row['particles_ms']
        lines.append((row['name'], *cells, *times, solver / row['particles_ms']))
    header = (
        'method', *(tables.TITLES[key] for key in QUANTITIES), 'force, ms a frame',
        'all particles, ms a frame', 'solver over it',
    )  # fmt: skip
    return markdown.table(header, lines)


def picked(path: str, *budgets: str) -> str:
    """The method with the smallest mean error of those whose frame takes at most so many ms, for
    the force alone and for soil with all particles; from the JSON. ValueError: a budget that is no
    number."""
    rows, lines = files.read_json(path)['rows'], []
    for budget in budgets:
        line: list = [float(budget)]
        for clock, error in (('load_ms', 'force_relative_l2'), ('particles_ms', 'soil_mm')):
            within = [row for row in rows if row[error] and row[clock] <= float(budget)]
            best = min(within, key=lambda row: np.mean(row[error]), default=None)
            line += ['', ''] if best is None else [best['name'], markdown.mean(best[error])]
        lines.append(line)
    header = (
        'a frame may take, ms', 'for the force', tables.TITLES['force_relative_l2'],
        'for all particles', tables.TITLES['soil_mm'],
    )  # fmt: skip
    return markdown.table(header, lines)


def break_even(path: str) -> str:
    """What methods cost before their first frame, in CPU time: the solver's runs that they learn
    from, and training; and after how much motion with all particles the solver had cost more; from
    the JSON."""
    found = files.read_json(path)
    lines = []
    for name, trained in found['training_s'].items():
        runs = found['runs_s'][name]
        fastest = min(r['particles_ms'] for r in found['rows'] if r['name'].split(', ')[0] == name)
        frames = 1e3 * (runs + trained) / (found['solver_ms'] - fastest)
        lines.append((name, runs / 3600, trained / 3600, frames * found['frame_s'] / 60))
    header = ('method', "the solver's runs, h", 'training, h', 'break-even, minutes of motion')
    return markdown.table(header, lines)


def draw(path: str, protocol: dict, picture: str) -> None:
    """Soil against the time of a frame with all its particles, force against that of its force."""
    from matplotlib import figure, lines

    found = files.read_json(path)
    drawn = figure.Figure(figsize=(11, 5.2), layout='constrained')
    panels = zip(drawn.subplots(1, 2), QUANTITIES, ('particles_ms', 'load_ms'), strict=True)
    methods = list(dict.fromkeys(row['name'].split(', ')[0] for row in found['rows']))
    for axes, error, clock in panels:
        for row in (row for row in found['rows'] if row[error]):
            method, *more = row['name'].split(', ')
            seeds = np.array(row[error])
            spread = [[seeds.mean() - seeds.min()], [seeds.max() - seeds.mean()]]
            axes.errorbar(
                row[clock], seeds.mean(), spread, fmt='o' if more[-1] == 'C' else 's', ms=6,
                capsize=3, color=f'C{methods.index(method)}',
                alpha=0.4 + 0.6 * ('of' not in row['name'] or more[0][0] == more[0][5]),
            )  # fmt: skip
            if len(more) > 1:
                axes.annotate(
                    more[0][0], (row[clock], seeds.mean()), (5, 9 * int(more[0][0]) - 18),
                    textcoords='offset points', fontsize='small',
                )  # fmt: skip
        for name in LINES:
            if height := protocol['summary']['all'].get(name, {}).get(error, {}).get('mean'):
                axes.axhline(height[0], color='0.6', lw=1, ls='--')
                place = {'xycoords': ('axes fraction', 'data'), 'ha': 'left', 'va': 'bottom'}
                axes.annotate(name, (0.02, height[0]), fontsize='small', color='0.4', **place)
        axes.axvline(found['solver_ms'], color='0.5', lw=1.5)
        axes.annotate(
            'solver', (found['solver_ms'], 0.5), xycoords=('data', 'axes fraction'), rotation=90,
            ha='right', va='center', color='0.4', fontsize='small',
        )  # fmt: skip
        of = 'with all particles' if clock == 'particles_ms' else 'force only'
        axes.set(xscale='log', xlabel=f'ms a frame, {of}, one thread', ylabel=tables.TITLES[error])
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
    shown = [lines.Line2D([], [], marker='o', ls='', color=f'C{i}') for i in range(len(methods))]
    shown += [lines.Line2D([], [], marker=m, ls='', color='0.4') for m in 'os']
    labels = [*methods, 'in C, step by step', 'in Python']
    drawn.legend(shown, labels, loc='outside lower center', ncols=6, fontsize='small')
    drawn.suptitle('Test runs: mean errors (range of trainings); numbers: members of a soil field')
    files.write_atomically(picture, lambda name: drawn.savefig(name, format='png', dpi=110))


def define_flags() -> None:
    flags.DEFINE_string(
        'data_path', None, 'Datasets, separated by commas: the path is of the first; a soil field '
        'has learned from all.',
    )  # fmt: skip
    flags.DEFINE_string('protocol', None, 'JSON of `reports protocol` on it.')
    flags.DEFINE_string('soil_field', None, 'Folder of a soil field.')
    flags.DEFINE_multi_string('model', [], 'NAME=FOLDER of other methods, as in the protocol.')
    flags.DEFINE_multi_string('training_s', [], 'NAME=SECONDS of CPU that its training took.')
    flags.DEFINE_float(
        'solver_ms', None, 'CPU time of a frame of the solver on this processor; default: the '
        'median of the test runs that state it.', lower_bound=0.0,
    )  # fmt: skip
    flags.DEFINE_multi_string('budget_ms', [], 'Only picks, from the JSON that is there.')
    flags.DEFINE_string('output_path', None, 'Path of .json and .png, without it.', required=True)


def main(values) -> None:
    path = f'{values.output_path}.json'
    if values.budget_ms:
        print(picked(path, *values.budget_ms))
        return
    for name in ('data_path', 'protocol', 'soil_field'):
        if not getattr(values, name):
            raise ValueError(f'--{name} is needed, or --budget_ms')
    first = values.data_path.split(',')[0]
    models = named_paths('model', values.model, 'FOLDER')
    trained = named_paths('training_s', values.training_s, 'SECONDS')
    protocol = judge.read(values.protocol)
    known = {method['name'] for method in protocol['methods']}
    if unknown := sorted({SOIL_FIELD, *models, *trained} - known):
        raise ValueError(f'--model: {values.protocol} judges {sorted(known)}, no {unknown}')
    data = {name: values.data_path if name == SOIL_FIELD else first for name in trained}
    found = {
        'schema_version': SCHEMA_VERSION,
        **record.provenance(1),
        'solver_ms': values.solver_ms or solver_ms(first),
        'frame_s': dataset.read_metadata(first)['dt'],
        'training_s': {name: float(seconds) for name, seconds in trained.items()},
        'runs_s': {name: runs_s(folders) for name, folders in data.items()},
        'rows': measured(first, values.soil_field, models, protocol),
    }
    files.write_json(path, found)
    draw(path, protocol, f'{values.output_path}.png')
    print(f'{table(path)}\n{break_even(path)}')
