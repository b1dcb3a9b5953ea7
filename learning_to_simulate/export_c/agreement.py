"""Compares C with TensorFlow's stepper over whole test rollouts, every frame, run by run.

How much of a difference is round-off that a model makes larger is told by a third rollout: that of
TensorFlow from a start in which every coordinate is one unit of float32's last place higher.

Example:
  python -m learning_to_simulate.export_c.agreement --output=docs/c/agreement.json \\
      --models=models/excavation/pcg,models/wheel/pcg
"""

import os

import numpy as np
from absl import flags

from learning_to_simulate import command, registry, rollout_status
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.export_c import c_stepper, starts
from learning_to_simulate.live import stepping
from learning_to_simulate.rollout_status import RolloutStatus
from pca_tools import files

PARTICLES_EVERY = 50


def measure(model_path: str, data_path: str) -> list[dict]:
    """One row for each test run.

    Args:
      model_path, data_path: a model in a subspace that has a C form, and its dataset.

    Returns:
      dicts of `frames` that were inside the bounds (beyond them nothing is compared), `modes` and
      `force`, largest differences as shares of the motion and of the largest force, `nudged_modes`
      and `nudged_force`, the same between TensorFlow and TensorFlow from the nudged start,
      `particles_m`, `same_status`, whether kind, frame and node of the judgements agree.

    Raises:
      FileNotFoundError, ValueError: no model or dataset there, or no C form.
      c_library.NoCompiler: there is no C compiler.
    """
    model, n, space, found = starts.read_model(model_path, data_path)
    mine = c_stepper.CStepper(model, n, space, starts=found)
    steppers = mine, stepping.Stepper(model, n, space), stepping.Stepper(model, n, space)
    known, rows = model.simulator.scene.rigid_motion.is_known, []
    for group in registry.open_model(model_path, data_path, 'test').groups:
        for run in range(len(group.position)):
            rows.append(_row(steppers, model, group.select(run), n, known))
    return rows


def _row(steppers, model, group, n, known):
    truth = group.position[0]
    nudged = np.nextafter(truth[:H].astype(np.float32), np.float32(np.inf)).astype(np.float64)
    frames, particles = ([], [], []), []
    for stepper, start in zip(steppers, (truth[:H], truth[:H], nudged)):
        stepper.reset(start, group.context_at(H, 0))
    for k in range(H, len(truth)):
        context = group.context_at(k, 0) if group.context_changes else None
        for stepper, kept in zip(steppers, frames):
            kept.append(stepper.step(truth[k, :n] if known else None, context))
        if (k - H) % PARTICLES_EVERY == 0:
            pair = (stepper.particles() for stepper in steppers[:2])
            particles.append(np.abs(np.subtract(*pair)).max())
    position = [[np.concatenate([f.rigid_pose, f.modes]) for f in kept] for kept in frames]
    force = [np.array([f.force for f in kept]) for kept in frames]
    expected, size = np.array(position[1]), np.abs(force[1])
    s = model.simulator
    judged = rollout_status.judge(
        group, expected[None], force[1][None], s.statistics, s.scene
    )[0]  # fmt: skip
    is_inside = judged.status in (RolloutStatus.OK, RolloutStatus.EXTRAPOLATING)
    count = len(expected) if is_inside else judged.frame - H
    motion = np.abs(expected[:count] - truth[H - 1]).max(initial=0.0)
    row = {'record': int(group.record[0]), 'frames': count}
    for name, i in (('', 0), ('nudged_', 2)):
        apart = np.abs(np.array(position[i]) - expected)[:count].max(initial=0.0)
        row[f'{name}modes'] = float(apart / motion)
        pulled = np.abs(force[i] - force[1])[:count].max(initial=0.0)
        row[f'{name}force'] = float(pulled / size[:count].max(initial=0.0))
    compared = particles[: 1 + (count - 1) // PARTICLES_EVERY]
    return row | {
        'particles_m': float(max(compared)),
        'same_status': steppers[0].judgement[:3] == judged[:3],
    }


def table(path: str) -> str:
    """The largest of all runs of each model, from a JSON file of this command."""
    lines = [
        '| model | runs | frames inside | C: motion | force | particles, m '
        '| nudged start: motion | force | status agrees |',
        '|---|---|---|---|---|---|---|---|---|',
    ]
    for model, rows in files.read_json(path).items():
        worst = [
            f'{max(row[key] for row in rows):.1e}'
            for key in ('modes', 'force', 'particles_m', 'nudged_modes', 'nudged_force')
        ]
        agreed = sum(row['same_status'] for row in rows)
        lines.append(
            f'| {model} | {len(rows)} | {sum(row["frames"] for row in rows)} | '
            f'{" | ".join(worst)} | {agreed} of {len(rows)} |'
        )
    return '\n'.join(lines).replace('e-0', 'e-')


def run(values, measure=measure) -> None:
    """Runs the command with its flags: `measure` of each model, into one JSON file."""
    command.import_tensorflow(num_threads=1)
    found = {}
    if values.output and os.path.exists(values.output):
        found = files.read_json(values.output)
    for path in values.models:
        scene = os.path.basename(os.path.dirname(os.path.normpath(path)))
        print(f'comparing {path} ...', flush=True)
        found[os.path.normpath(path)] = measure(path, os.path.join(values.data_root, scene))
        if values.output:
            files.write_json(values.output, found)
    for name, rows in found.items():
        print(name, *rows, sep='\n  ')


if __name__ == '__main__':
    names = 'pcg', 'pcg_thesis', 'fcg_original'
    flags.DEFINE_list(
        'models', [f'models/{s}/{n}' for s in ('excavation', 'wheel') for n in names],
        'Model folders.',
    )  # fmt: skip
    flags.DEFINE_string('data_root', 'datasets', 'Folder of the datasets, named as the scenes.')
    flags.DEFINE_string('output', None, 'JSON file for the figures; other models in it stay.')
    command.start(run)
