"""Compares the shipped models with one run of the solver per scene that no model has seen.

The runs are of the test split of the data of record: a blade that cuts, lifts and cuts again, and a
wheel under a load that changes. The soil field predicts them on their terrain, a graph network in
the subspace beside it, from the motion of the tool. The table holds their errors next to those of
persistence, and their times as a user gets them, stepping from Python, next to the solver's.

Examples:
    python -m run_scripts.demo --output_path=demo_output

    # another test run: a kind and a seed, or a case of the grid
    python -m run_scripts.demo --scenes=excavation --cases=reverse_0001 --output_path=demo_output
"""

import dataclasses
import os
import statistics
import time

import numpy as np
import tqdm
from absl import flags

from learning_to_simulate import command
from mpm import scenes
from pca_tools import dataset, files
from reports import markdown, timing
from reports.record import ROOT

MODELS = {'soil_field': 'soil field', 'pcg': 'graph network (pcg)'}
CASES = {'excavation': 'lift_0001', 'wheel': 'load_0001'}
SOIL, FORCE, DRAWBAR = 'soil error, mm', 'force error, N', 'along the way (drawbar), N'
STEP, PARTICLES, COUNT = 'step and force, ms', 'and all particles, ms', 'particles'
COLUMNS = 'method', SOIL, DRAWBAR, FORCE, STEP, PARTICLES, COUNT
EVERY = 20  # frames in which a soil field is timed
LEGEND = f"""
soil error: root mean square over the solver's own particles. Forces: root mean square
per component, and its share of the true force; persistence: soil and force stay.
Times: medians of steps from Python, in C where a compiler is at hand; of the
soil field in the {EVERY} frames of the largest forces; of the solver CPU time.
Particles: of the soil field those about the tool, of the network the solver's own.
"""


def test_run(name: str, case: str) -> int:
    """Number of a test run of the shipped data; ValueError for another one."""
    cases = dataset.read_metadata(os.path.join(ROOT, 'datasets', name))['cases']['test']
    found = [str(run['case']) for run in cases]
    if case not in found:
        raise ValueError(f'{name} has no test run {case!r}; there are {", ".join(found)}')
    return found.index(case)


def evaluate(name: str, number: int, out: str) -> tuple[list[dict], list[str]]:
    """Rolls out the shipped models on a test run of a scene, and draws them into a folder; returns
    one dict per row of the table, and the pictures."""
    import learning_to_simulate as lts
    from learning_to_simulate import registry
    from learning_to_simulate.soil_field.evaluation import SoilEvaluator

    data = lts.Dataset(os.path.join(ROOT, 'datasets', name))
    parameters = data.metadata['cases']['test'][number]
    solver = 1e3 * parameters['solver_cpu_s'] / scenes.FRAMES
    rows = [{'method': 'solver (ground truth)', PARTICLES: solver}]
    rollouts = []
    for preset, title in MODELS.items():
        model = lts.load(os.path.join(ROOT, 'models', name, preset))
        opened = registry.open_model(model.path, data.path, 'test')
        if preset == 'soil_field':
            evaluator = SoilEvaluator(model.model, under_load=False)
            results, summary = evaluator.run([opened.groups[number]], 'test')
            rollouts.append(results[0][-1])
            steps, wholes, count = field_steps(model, rollouts[0])
            rows.append(_row('persistence', summary['mean']['stay_still']))
        else:
            found = (g.take(np.flatnonzero(g.record == number)) for g in opened.groups)
            groups = [group for group in found if len(group.record)]
            _, summary = opened.evaluator.run(groups, 'test')
            rollouts.append(model.rollout(data.test[number]))
            record = data.test.records[number]
            poses = record.rigid_pose.astype(float)
            steps, wholes = (
                timing.stepping(model.stepper(), poses, record.step_context, has_particles)
                for has_particles in (False, True)
            )
            wholes, count = wholes[1:], rollouts[1].scene.n_soil  # the first one compiles
        times = {STEP: 1e3 * statistics.median(steps), PARTICLES: 1e3 * statistics.median(wholes)}
        rows.append(_row(title, summary['mean']['model']) | times | {COUNT: count})
    field, network = rollouts
    return rows, draw(name, field, network, out)


def field_steps(model, rollout) -> tuple[list[float], list[float], int]:
    """Times of an `api.TerrainModel` that is stepped from Python along a `TerrainRollout` of it, in
    the frames of the largest forces, as a tool in the air moves no particles: seconds of steps with
    their force, and of steps with their force and all particles, which are asked for in every
    frame; the number of particles."""
    loaded = np.argsort(np.linalg.norm(rollout.force[1:], axis=1))[-EVERY:]
    times: list[list[float]] = []
    for has_particles in (False, True):
        live = model.stepper(rollout.before.clone(), rollout.tool)
        live.start(rollout.pose[0])
        seconds = timing.steps(live, rollout.pose[1:], has_particles=has_particles)
        times.append([seconds[i] for i in loaded])
    return times[0], times[1], len(live.particles())


def _row(name, mean):
    force, drawbar = (
        f'{mean[f"{load}_rmse"]:.3g} ({100 * mean[f"{load}_relative_l2"]:.0f} %)'
        for load in ('force', 'drawbar')
    )
    return {'method': name, SOIL: mean['soil_mm'], FORCE: force, DRAWBAR: drawbar}


def table(name: str, case: str, rows: list[dict]) -> str:
    """The rows as aligned text."""
    cells = [['-' if row.get(title) is None else row[title] for title in COLUMNS] for row in rows]
    return f'{name}, {case}\n{markdown.table(COLUMNS, cells, aligned=True)}'


def draw(name: str, field, network, out: str) -> list[str]:
    """Draws a `TerrainRollout` and the `SoilRollout` of a network of the same run into a folder;
    returns the files.

    `terrain` shows the soil field on its terrain: sections, maps and forces beside the solver's.
    `particles` shows it and the graph network beside the solver's own particles. The films of the
    README, `docs/lift.gif` and `docs/wheel.gif`, are made this way.
    """
    from learning_to_simulate import metrics, render_rollout
    from learning_to_simulate.rendering import rollout_frames

    def progress(drawn, label):
        return tqdm.tqdm(drawn, label, unit='frame', disable=None)

    os.makedirs(out, exist_ok=True)
    paths = [os.path.join(out, f'terrain.{kind}') for kind in ('png', 'gif')]
    for path in paths:
        field.render(path, progress=progress)
    other = rollout_frames.of_rollout(network)
    title = f'{name.capitalize()}: test run {field.run.case}, seen by no model'
    other = dataclasses.replace(other, label=MODELS['pcg'], title=title)
    truth = network.soil_truth
    places = [list(field.frames).index(frame) for frame in truth.frames]
    predicted = field.particles[places]
    shown = dataclasses.replace(
        other,
        label=MODELS['soil_field'],
        soil=other.soil | {'prediction': predicted},
        rigid=other.rigid | {'prediction': other.rigid['truth']},
        force=(other.force or {}) | {'prediction': field.force},
        soil_mm=truth.soil_mm(predicted),
        soil_rms_mm=other.soil_rms_mm
        | {'prediction': metrics.rms_mm(truth.mean_square(predicted))},
        notes=(),
    )
    target = os.path.join(out, 'particles')
    return paths + render_rollout.render_frames(
        shown, target, ['png', 'gif'], step_stride=8, progress=progress, beside=[other]
    )


def define_flags() -> None:
    flags.DEFINE_string('output_path', 'demo_output', 'Folder for everything that is written.')
    flags.DEFINE_list('scenes', sorted(scenes.SCENES), 'Which scenes.')
    flags.DEFINE_list('cases', None, 'One run per scene; default: one that no model has seen.')


def main(values) -> None:
    """ValueError: no such scenes, or other runs than the data of record have."""
    started = time.perf_counter()
    out = os.path.abspath(values.output_path)
    if unknown := sorted(set(values.scenes) - set(scenes.SCENES)):
        raise ValueError(f'unknown scenes {unknown}; there are {sorted(scenes.SCENES)}')
    cases = values.cases or [CASES[name] for name in values.scenes]
    if len(cases) != len(values.scenes):
        raise ValueError(f'{len(cases)} cases for {len(values.scenes)} scenes')
    numbers = [test_run(name, case) for name, case in zip(values.scenes, cases)]
    print('learned simulators: rolling out', flush=True)
    results: dict = {}
    pictures: list[str] = []
    for name, case, number in zip(values.scenes, cases, numbers):
        rows, drawn = evaluate(name, number, os.path.join(out, name))
        results[name] = {'case': case, 'rows': rows}
        pictures += drawn
    text = '\n\n'.join(table(name, r['case'], r['rows']) for name, r in results.items())
    files.write_text(os.path.join(out, 'table.txt'), text + '\n')
    files.write_json(os.path.join(out, 'table.json'), results)
    print(f'\n{text}\n{LEGEND}')
    print(*map(os.path.relpath, pictures), sep='\n')
    print(f'everything is in {os.path.relpath(out)}; {time.perf_counter() - started:.0f} s')


if __name__ == '__main__':
    define_flags()
    command.start(main)
