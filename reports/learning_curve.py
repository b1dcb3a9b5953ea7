"""How the error of a soil field's load falls with the number of its training runs.

Networks of the load alone are trained on a quarter, half and all of the training runs of datasets
(of each kind alike), from several seeds, and judged on the test runs over the terrain as it was
recorded, so that no error of the surface adds to theirs. The exponent p of error ~ runs^-p from
half to all of them says how many runs a smaller error takes, as long as nothing else bounds it.

Examples:
    python -m reports learning_curve --output_path=docs/learning_curve.json
    python -m reports documents docs/results.md     # the table again, from the JSON
"""

import dataclasses
from concurrent import futures

import numpy as np
from absl import flags

from learning_to_simulate import command, metrics
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from pca_tools import files
from reports import markdown, record

DATA = {
    'blade': ('excavation', 'excavation_wide', 'excavation_more'),
    'wheel': ('wheel', 'wheel_more'),
}
PARTS = 4, 2, 1  # one run in so many
SEEDS = 3
WANTED = 0.12


def exponent(runs, errors) -> float:
    """p of error ~ runs^-p between the last two points of a curve; where it does not fall, 0."""
    fallen = np.log(errors[-2] / errors[-1])
    return float(max(fallen / np.log(runs[-1] / runs[-2]), 0.0))


def runs_for(wanted: float, runs, errors) -> float | None:
    """How many runs an error takes if the curve goes on like that; None where it does not fall."""
    p = exponent(runs, errors)
    return float(runs[-1] * (errors[-1] / wanted) ** (1.0 / p)) if p > 0.05 else None


def curve(tool: str, num_steps: int) -> list[dict]:
    """A row for each part of the training runs and seed: relative L2 of force and drawbar, mean and
    median over the test runs, after `num_steps` of training. FileNotFoundError, ValueError: see
    `runs.read`."""
    command.import_tensorflow(1)
    from learning_to_simulate.soil_field import runs as runs_lib
    from learning_to_simulate.soil_field import samples, settings, training

    config = dataclasses.replace(settings.PRESETS['soil_field'], num_steps=num_steps)
    folders = [f'datasets/{name}' for name in DATA[tool]]
    known, judged = (runs_lib.read_all(folders, split, False) for split in ('train', 'test'))
    known.sort(key=lambda run: (run.kind, run.case))
    first = training.make_field(config, tool)
    parts = [training.parts_of(first, [run], only=('load',))['load'] for run in known]
    tests = [samples.episode_of(run) for run in judged]
    found = []
    for every in PARTS:
        for seed in range(SEEDS):
            field = training.make_field(dataclasses.replace(config, seed=seed), tool)
            some = parts[seed % every :: every]
            pairs = (('load', part) for of_run in some for part in of_run)
            training.fit(field, training.pooled(pairs), progress=False)
            row: dict[str, float] = {'every': every, 'runs': len(some), 'seed': seed}
            errors = []
            for test in tests:
                found_loads = field.loads(test.frames).mean(axis=0)
                force, truth = (loads[None, H:, :3] for loads in (found_loads, test.loads))
                errors.append(metrics.load_errors(force, truth, axes=(0, 1, 2)))
            for name in ('force', 'drawbar'):
                of = [float(error[f'{name}_relative_l2'][0]) for error in errors]
                row[name], row[f'{name}_median'] = float(np.mean(of)), float(np.median(of))
            found.append(row)
            print(tool, row, flush=True)
    return found


def table(path: str) -> str:
    """The curves of the JSON: means over seeds."""
    rows = []
    for tool, found in files.read_json(path)['curves'].items():
        counts, *means = (
            [np.mean([r[name] for r in found if r['every'] == every]) for every in PARTS]
            for name in ('runs', 'force', 'drawbar_median')
        )
        for n, *values in zip(counts, *means, strict=True):
            rows.append((f'{tool}, {n:.0f} training runs', *values))
        needed = [runs_for(WANTED, counts, errors) for errors in means]
        rows.append((f'{tool}, runs for {WANTED}', *(f'{x:.0f}' if x else '' for x in needed)))
    return markdown.table(('', 'force, rel. L2', 'drawbar, rel. L2 (median)'), rows)


def main(values) -> None:
    command.writable_folder(str(values.output_path.rpartition('/')[0] or '.'))
    with futures.ProcessPoolExecutor(len(DATA)) as pool:
        jobs = {tool: pool.submit(curve, tool, values.num_steps) for tool in DATA}
        made = record.provenance(1) | {'curves': {tool: job.result() for tool, job in jobs.items()}}
    files.write_json(values.output_path, made)
    print(table(values.output_path))


if __name__ == '__main__':
    flags.DEFINE_string('output_path', None, 'JSON file to write.', required=True)
    flags.DEFINE_integer('num_steps', 4000, 'Of each training; half of the preset.', 1)
    command.start(main)
