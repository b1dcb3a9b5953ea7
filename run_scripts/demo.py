"""Simulates one unseen case per scene with the solver and with the shipped models, and compares
them.

The solver makes the ground truth of both cases side by side; the learned simulators roll them out
from the first six frames; the table holds their errors and run times next to the trivial
predictors. Where the shipped models have learned from another version of the solver, they are
judged on the recorded test runs of that version, and the new run gives the solver's time only.

Examples:
    python -m run_scripts.demo --output_path=demo_output

    # another case of the excavation (1 to 250), with the solver run of before where there is one
    python -m run_scripts.demo --scenes=excavation --cases=127 --output_path=demo_output
"""

import json
import os
import subprocess
import sys
import time

import tqdm
from absl import app, flags

from mpm import raw_run, scenes, versions
from reports import markdown
from storage import messages

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
MODELS = ('fcg_original', 'pcg')
COLUMNS = (
    'method', 'edges', 'soil RMS mm', 'with truncation', 'force rel. L2', 's per simulated s',
    'times faster',
)  # fmt: skip


def simulate(name: str, case: int, folder: str, position: int) -> subprocess.Popen:
    """Starts the solver on one case; its progress bar takes line `position` of the terminal."""
    command = [
        sys.executable, '-m', 'mpm.generate', f'--scene={name}', f'--cases={case}',
        f'--output_path={folder}',
    ]  # fmt: skip
    environment = os.environ | {'TQDM_POSITION': str(position)}
    return subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL)


def judged_on(name: str, raw: str, out: str) -> tuple[str, str]:
    """Returns the dataset that the shipped models are judged on, and what it is in words.

    That of the raw run, if models and run are of one version of the solver.
    """
    from pca_tools import convert
    from pca_tools.metadata import read_metadata

    like = os.path.join(ROOT, 'datasets', name)
    learned = read_metadata(like)['cases']['train'][0].get('solver_version', '1')
    if learned != versions.SOLVER_VERSION:
        return like, (
            f'recorded test runs of solver version {learned}, which the models learned from '
            f'(the new run is of version {versions.SOLVER_VERSION})'
        )
    data = os.path.join(out, 'dataset')
    convert.convert(raw, data, like=like, overwrite=os.path.isdir(data))
    return data, 'the new run'


def evaluate(name: str, raw: str, data: str, out: str) -> list[dict]:
    """Rolls out the shipped models on the test runs of a dataset.

    Args:
        name: scene, names the folder in `models/`.
        raw: folder with the raw run that tells the solver's time.
        data: dataset folder.
        out: folder for rollouts and pictures.

    Returns:
        One dict per row of the table.
    """
    from learning_to_simulate import evaluation
    from learning_to_simulate.methods import registry

    (run,) = raw_run.read_manifest(raw)['runs']
    solver = run['parameters']['solver_cpu_s'] * scenes.FRAME_RATE / scenes.FRAMES
    rows = [{'method': 'solver (ground truth)', 's per simulated s': solver, 'times faster': 1}]
    for preset in MODELS:
        opened = registry.open_model(os.path.join(ROOT, 'models', name, preset), data, 'test')
        model, metadata, groups = opened.model, opened.metadata, opened.groups
        evaluator = evaluation.Evaluator(model, metadata)
        results, summary = evaluator.run(groups, 'test')
        evaluation.save_rollouts(os.path.join(out, preset), 'test', results, summary, metadata)
        mean = summary['mean']
        if len(rows) == 1:
            rows += [_row(label, mean[key]) for key, label in markdown.TRIVIAL.items()]
        row = _row(preset, mean['model'])
        row['edges'] = summary['runs']['model'][0]['edges']
        row['s per simulated s'] = mean['model']['seconds_per_simulated_second']
        row['times faster'] = solver / row['s per simulated s']
        rows.append(row)
    floor = 1e3 * summary['projection_mse'] ** 0.5
    rows.append({'method': markdown.FLOOR, 'soil RMS mm': 0.0, 'with truncation': floor})
    return rows


def _row(name, mean):
    return {
        'method': name,
        'soil RMS mm': mean['soil_rms_mm'],
        'with truncation': mean['soil_rms_mm_full'],
        'force rel. L2': mean['force_relative_l2'],
    }


def table(name: str, case: int, rows: list[dict]) -> str:
    """The rows as aligned text."""
    cells = [['-' if row.get(title) is None else row[title] for title in COLUMNS] for row in rows]
    return f'{name}, case {case}\n{markdown.table(COLUMNS, cells, aligned=True)}'


def _bar(drawn, label):
    return tqdm.tqdm(drawn, desc=label, unit='frame', disable=None)


def draw(out: str, data: str) -> list[str]:
    """Pictures and films of every model's first rollout; returns the files."""
    from learning_to_simulate import render_rollout

    written = []
    for preset in MODELS:
        _, paths = render_rollout.render(
            os.path.join(out, preset, 'rollout_test_0.npz'),
            data,
            os.path.join(out, preset),
            formats=['png', 'gif'],
            step_stride=4,
            label=preset,
            progress=_bar,
        )
        written += paths
    return written


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('output_path', 'demo_output', 'Folder for everything that is written.')
    flags.DEFINE_list('scenes', sorted(scenes.SCENES), 'Scenes to simulate.')
    flags.DEFINE_list('cases', None, 'One case per scene; default: a case that no model has seen.')


def main(_) -> None:
    """Runs the command; bad input ends with its message."""
    started = time.perf_counter()
    values = flags.FLAGS
    out = os.path.abspath(values.output_path)
    try:
        chosen = [scenes.scene_named(name) for name in values.scenes]
        cases = [scene.demo_case for scene in chosen]
        if values.cases:
            if len(values.cases) != len(chosen):
                raise ValueError(f'{len(values.cases)} cases for {len(chosen)} scenes')
            cases = [
                scenes.select_cases(scene, case)[0] for scene, case in zip(chosen, values.cases)
            ]
    except ValueError as error:
        sys.exit(f'error: {messages.printable(error)}')
    raw = [os.path.join(out, s.name, f'raw_{case}') for s, case in zip(chosen, cases)]
    print('solver: ' + ', '.join(f'{s.name} case {c}' for s, c in zip(chosen, cases)))
    running = [
        simulate(scene.name, case, folder, line)
        for line, (scene, case, folder) in enumerate(zip(chosen, cases, raw))
    ]
    if any([process.wait() for process in running]):
        sys.exit('error: the solver failed, see above')
    print('\n' * len(running) + 'learned simulators: rolling out')
    results, pictures = {}, []
    for scene, case, folder in zip(chosen, cases, raw):
        target = os.path.join(out, scene.name)
        data, judged = judged_on(scene.name, folder, target)
        rows = evaluate(scene.name, folder, data, target)
        results[scene.name] = {'case': case, 'judged_on': judged, 'rows': rows}
        pictures += draw(target, data)
    text = '\n\n'.join(
        f'{table(name, r["case"], r["rows"])}\nmodels on: {r["judged_on"]}'
        for name, r in results.items()
    )
    with open(os.path.join(out, 'table.txt'), 'w', encoding='utf-8') as file:
        file.write(text + '\n')
    with open(os.path.join(out, 'table.json'), 'w', encoding='utf-8') as file:
        json.dump(results, file, indent=2)
    print('\n' + text + '\n')
    print('soil RMS: error within the 8 modes; with truncation: what these cannot hold, too.')
    print('force of the trivial rows: the last known force, the mean force of the training runs.')
    print('time: CPU seconds of the solver on one core; wall seconds of one compiled rollout.\n')
    for path in pictures:
        print(os.path.relpath(path))
    print(f'everything is in {os.path.relpath(out)}; {time.perf_counter() - started:.0f} s')


if __name__ == '__main__':
    define_flags()
    app.run(main)
