"""Compares the shipped models with one run of the solver per scene that no model has seen.

The runs are of the test split of the data of record: a blade that cuts, lifts and cuts again, and a
wheel under a load that changes. The models predict them from the motion of the tool; the table
holds their errors next to those of the trivial predictors, and their times as a user gets them,
stepping from Python, next to the solver's CPU time.

Examples:
    python -m run_scripts.demo --output_path=demo_output

    # another test run: a kind and a seed, or a case of the grid
    python -m run_scripts.demo --scenes=excavation --cases=reverse_0007 --output_path=demo_output
"""

import os
import shutil
import statistics
import time

import tqdm
from absl import flags

from mpm import scenes
from mpm.motions import catalogue
from pca_tools import files
from reports import command, markdown, timing
from reports.record import ROOT

# Of each scene: the data of record, the models, and a test run of it.
DATA = {'excavation': 'excavation_v2', 'wheel': 'wheel_v2'}
MODELS = {'excavation': ('pcg', 'mlp_driven', 'swept_field'), 'wheel': ('pcg', 'swept_field')}
LABELS = {'swept_field': 'swept field', 'pcg': 'graph network (pcg)'}
CASES = {'excavation': 'lift_0158', 'wheel': 'load_0007'}
SOIL, FORCE, DRAWBAR = 'soil error, mm', 'force error, N', 'along the way (drawbar), N'
STEP, PARTICLES, FASTER = 'step and force, ms', 'and all particles, ms', 'times faster'
COLUMNS = 'method', SOIL, DRAWBAR, FORCE, STEP, PARTICLES, FASTER
# Steps after which the particles are asked for, too; a whole run of them takes long in TensorFlow.
EVERY = 20


def single_run(name: str, case: int | str, folder: str) -> dict:
    """Writes a dataset whose only test run is one of the data of record.

    Returns:
        The run's parameters.

    Raises:
        ValueError: it is no test run of the data of record.
    """
    from pca_tools import dataset, subset

    data = os.path.join(ROOT, 'datasets', DATA[name])
    cases = dataset.read_metadata(data)['cases']
    found = [run['case'] for run in cases['test']]
    if case not in found:
        raise ValueError(f'{name} has no test run {case!r}; there are {", ".join(map(str, found))}')
    first = sum(len(cases[split]) for split in ('train', 'valid'))
    shutil.rmtree(folder, ignore_errors=True)
    places = {'train': [0], 'valid': [len(cases['train'])], 'test': [first + found.index(case)]}
    subset.deal(data, folder, places)
    return cases['test'][found.index(case)]


def evaluate(name: str, run: dict, data: str, out: str) -> list[dict]:
    """Rolls out the shipped models on a run of the solver.

    Args:
        name: scene.
        run: its parameters.
        data: dataset with the run.
        out: folder for rollouts and pictures.

    Returns:
        One dict per row of the table.
    """
    from learning_to_simulate import evaluation, registry
    from pca_tools import dataset

    (record,) = dataset.read_split(data, 'test')
    solver = 1e3 * run['solver_cpu_s'] / scenes.FRAMES
    rows = [{'method': 'solver (ground truth)', PARTICLES: solver, FASTER: 1}]
    for preset in MODELS[name]:
        path = os.path.join(ROOT, 'models', DATA[name], preset)
        opened = registry.open_model(path, data, 'test')
        results, summary = opened.evaluator.run(opened.groups, 'test')
        folder = os.path.join(out, preset)
        evaluation.save_rollouts(folder, 'test', results, summary, opened.metadata)
        mean = summary['mean']
        if len(rows) == 1:
            rows += [_row(label, mean[key]) for key, label in markdown.TRIVIAL.items()]
        row = _row(preset, mean['model']) | stepping_ms(path, record)
        rows.append(row | {FASTER: solver / row[PARTICLES]})
    return rows


def stepping_ms(path: str, record) -> dict:
    """Milliseconds of a frame of a model that is stepped from Python by the poses of a run.

    Args:
      path: model folder.
      record: `dataset.Trajectory` with poses.

    Returns:
      medians: of a step with its force, and of a step with its force and all particles.
    """
    import learning_to_simulate as lts

    live, poses = lts.load(path).stepper(), record.rigid_pose.astype(float)
    steps, wholes = timing.stepping(live, poses, record.step_context, EVERY)
    # The first ones compile.
    return {STEP: 1e3 * statistics.median(steps), PARTICLES: 1e3 * statistics.median(wholes[1:])}


def _row(name, mean):
    force, drawbar = (
        f'{mean[f"{load}_rmse"]:.3g} ({100 * mean[f"{load}_relative_l2"]:.0f} %)'
        for load in ('force', 'drawbar')
    )
    return {'method': name, SOIL: mean['soil_mm'], FORCE: force, DRAWBAR: drawbar}


def table(name: str, case: int | str, rows: list[dict]) -> str:
    """The rows as aligned text."""
    cells = [['-' if row.get(title) is None else row[title] for title in COLUMNS] for row in rows]
    return f'{name}, {case}\n{markdown.table(COLUMNS, cells, aligned=True)}'


def draw(name: str, out: str) -> list[str]:
    """A picture and a film of the swept field beside the graph network; returns the files.

    Those of the README, `docs/lift.gif` and `docs/wheel.gif`, are made this way.
    """
    from learning_to_simulate import render_rollout

    beside, shown = MODELS[name][0], MODELS[name][-1]
    _, paths = render_rollout.render(
        os.path.join(out, shown, 'rollout_test_0.npz'),
        os.path.join(out, 'dataset'),
        out,
        formats=['png', 'gif'],
        step_stride=4,
        label=LABELS[shown],
        progress=lambda drawn, label: tqdm.tqdm(drawn, label, unit='frame', disable=None),
        beside={LABELS[beside]: os.path.join(out, beside, 'rollout_test_0.npz')},
    )
    return paths


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('output_path', 'demo_output', 'Folder for everything that is written.')
    flags.DEFINE_list('scenes', sorted(scenes.SCENES), 'Which scenes.')
    flags.DEFINE_list('cases', None, 'One run per scene; default: one that no model has seen.')


def main(values, _) -> None:
    """Runs the command.

    Raises:
        ValueError: no such scenes, or other runs than the data of record have.
    """
    started = time.perf_counter()
    out = os.path.abspath(values.output_path)
    chosen = [scenes.scene_named(name) for name in values.scenes]
    names = values.cases or [CASES[scene.name] for scene in chosen]
    if len(names) != len(chosen):
        raise ValueError(f'{len(names)} cases for {len(chosen)} scenes')
    cases = [catalogue.select_runs(scene, [name])[0] for scene, name in zip(chosen, names)]
    print('learned simulators: rolling out', flush=True)
    results, pictures = {}, []
    for scene, case in zip(chosen, cases):
        target = os.path.join(out, scene.name)
        data = os.path.join(target, 'dataset')
        run = single_run(scene.name, case, data)
        results[scene.name] = {'case': case, 'rows': evaluate(scene.name, run, data, target)}
        pictures += draw(scene.name, target)
    text = '\n\n'.join(table(name, r['case'], r['rows']) for name, r in results.items())
    files.write_text(os.path.join(out, 'table.txt'), text + '\n')
    files.write_json(os.path.join(out, 'table.json'), results)
    print('\n' + text + '\n')
    print("soil error: root mean square over the solver's own particles. Forces: root mean square")
    print('per component, and its share of the true force; persistence: the last known force,')
    print('constant velocity: the mean force of the training runs. Times: medians of steps from')
    print("Python, in C where a compiler is at hand; the solver's CPU time of a frame, one core.\n")
    for path in pictures:
        print(os.path.relpath(path))
    print(f'everything is in {os.path.relpath(out)}; {time.perf_counter() - started:.0f} s')


if __name__ == '__main__':
    command.start(define_flags, main)
