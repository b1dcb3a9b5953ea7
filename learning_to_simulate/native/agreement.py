"""Compares models in C with the same models by TensorFlow: of an exported project over a recorded
run, and over whole test runs, every frame, run by run.

A model in a subspace makes round-off larger. A third rollout shows by how much: that of TensorFlow
from a start in which every coordinate is one unit of float32's last place higher.

Example:
  python -m learning_to_simulate.native.agreement --output=build/agreement.json \\
      --models=models/excavation/pcg,models/excavation_v2/swept_field
"""

import os
import tempfile

import numpy as np
from absl import flags

from learning_to_simulate import checkpoints, command, registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import starts as live_starts
from learning_to_simulate.live.engine import SubspaceEngine
from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.native import field_data, library, project, starts
from learning_to_simulate.native.binding import CField, CSubspace
from learning_to_simulate.rollout_status import RolloutStatus, worse
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.swept_field.engine import FieldEngine
from learning_to_simulate.swept_field.network import ACROSS
from pca_tools import dataset, files, splits

# Largest difference to TensorFlow as a share of the motion, or of the largest force. Measured 1e-7
# to 5e-6. Where all of the body's motion is predicted, a rounding of its velocity lasts, and
# TensorFlow itself is up to 3e-4 from the same networks in float64.
TOLERANCE = 1e-4
TOLERANCE_OF_PREDICTED = 1e-3
COMPARED_STEPS = 40
# How many frames of a run have their particles compared.
PARTICLE_FRAMES = 5


def of_project(model_path, data_path, name, values, opened) -> dict:
    """Differences of a compiled project to TensorFlow over frames of the first test run.

    Args:
      model_path, data_path: of the model and its dataset.
      name, values: of `project.write`.
      opened: the results of `starts.read_model`; of a swept field (field, starts, subspace).

    Returns:
      `steps`, `kernel`, `relative_difference` by kind, `tolerance` and `particles_difference_m`; or
      `skipped`: why nothing was compared.

    Raises:
      ValueError: a difference above the tolerance.
      library.CompileFailed: the project does not compile.
    """
    is_field = project.is_field(values)
    with tempfile.TemporaryDirectory() as folder:
        project.write(folder, name, values)
        built = os.path.join(folder, 'model.so')
        try:
            library.compile_sources(built, folder)
        except library.NoCompiler as error:
            return {'skipped': str(error)}
        soil = (CField if is_field else CSubspace).open(built, name)
    tolerance = TOLERANCE
    if is_field:
        run = dataset.read_split(data_path, 'test')[0]
        if run.rigid_pose is None:
            return {'skipped': 'the first test run holds no pose of its tool'}
        case = dataset.read_metadata(data_path).get('cases', {}).get('test', [{}])[0]
        row = play_field(soil, Stepper(FieldEngine(*opened)), run, case.get('case'))
    else:
        model, n, space, _ = opened
        groups = registry.open_model(model_path, data_path, 'test').groups
        group = next((g for g in groups if g.n_rigid == n), None)
        if group is None:
            return {'skipped': f'no test run has {n} rigid nodes'}
        if model.simulator.scene.rigid_motion is RigidMotion.PREDICTED:
            tolerance = TOLERANCE_OF_PREDICTED
        row = play(soil, model, space, group.select(0), COMPARED_STEPS)
    difference = {'position': row['motion' if is_field else 'modes'], 'force': row['force']}
    if bad := {k: v for k, v in difference.items() if not v <= tolerance}:
        raise ValueError(
            f'the C code differs from the model by {bad}, more than {tolerance:g} of the motion or '
            f'force; nothing was written'
        )
    return {
        'steps': row['frames'],
        'kernel': soil.kernel,
        'relative_difference': difference,
        'tolerance': tolerance,
        'particles_difference_m': row['particles_m'],
    }


def play(soil: CSubspace, model, space, group, limit: int | None = None) -> dict:
    """Largest differences of a model in a subspace over a recorded run, by particles of the body.

    Args:
      soil: in C, of R rigid particles.
      model: `subspace_model.Model`.
      space: its `Subspace`, or None.
      group: one-run `RunGroup` of bodies of that size.
      limit: frames; None for all.

    Returns:
      `frames` that were inside the bounds (beyond them nothing is compared), `modes` and `force`,
      largest differences as shares of the motion and of the largest force, `nudged_modes` and
      `nudged_force`, the same between TensorFlow and TensorFlow from the nudged start,
      `particles_m`, and `same_status`, whether kind, frame and node of the judgements agree.
    """
    n, scene, truth = group.n_rigid, model.simulator.scene, group.position[0]
    coming = truth[H:] if limit is None else truth[H : H + limit]
    nudged = np.nextafter(truth[:H].astype(np.float32), np.float32(np.inf)).astype(np.float64)
    python, other = (Stepper(SubspaceEngine(model, None, space, n)) for _ in range(2))
    for stepper, start in ((soil, truth[:H]), (python, truth[:H]), (other, nudged)):
        judged = stepper.reset(start, group.context_at(H, 0))
    judged = python.state.frame.judgement
    every = max(1, len(coming) // PARTICLE_FRAMES)
    position, force, particles = ([], [], []), ([], [], []), []
    count = len(coming)
    for k, points in enumerate(coming[:, :n]):
        context = group.context_at(H + k, 0) if group.context_changes else None
        for stepper, places, loads in zip((soil, python, other), position, force):
            frame = stepper.step(points if scene.rigid_motion.is_known else None, context)
            places.append(np.concatenate([frame.rigid_pose, frame.modes]))
            loads.append(np.zeros(3) if frame.force is None else frame.force)
        judged = worse(judged, python.state.frame.judgement)
        if judged.status not in (RolloutStatus.OK, RolloutStatus.EXTRAPOLATING):
            count = min(count, k)
        if k % every == 0 and k < count and space is not None:
            particles.append(np.abs(soil.particles() - python.particles()).max())
    expected, size = np.array(position[1]), np.abs(force[1])[:count].max(initial=0.0)
    motion = np.abs(expected[:count] - truth[H - 1]).max(initial=0.0)
    row = {'frames': count}
    for name, i in (('', 0), ('nudged_', 2)):
        apart = np.abs(np.array(position[i]) - expected)[:count].max(initial=0.0)
        pulled = np.abs(np.subtract(force[i], force[1]))[:count].max(initial=0.0)
        row[f'{name}modes'] = float(apart / motion) if motion > 0 else float(apart)
        row[f'{name}force'] = float(pulled / size) if size > 0 else float(pulled)
    return row | {
        'particles_m': float(max(particles, default=0.0)),
        'same_status': soil.judgement[:3] == judged[:3],
    }


def play_field(soil: CField, live: Stepper, run, case: int | None) -> dict:
    """Largest differences of a swept field in C to Python over a recorded run.

    Args:
      soil: in C.
      live: of a `FieldEngine` of the same model.
      run: `dataset.Run` with poses.
      case: of the run, where a wheel begins.

    Raises:
      ValueError: a frame that one of them refuses and the other does not.

    Returns:
      `frames` until the first that both refuse; `motion`, of the particles, `force` and `torque`,
      shares of the largest; `height_m`, `particles_m`; `c_to_twin_m` and `python_to_twin_m`, of the
      particles to `twin_particles`; `same_status`, in how many frames.
    """
    poses = run.rigid_pose.astype(np.float64)
    contexts = [None] * len(poses)
    if run.step_context is None:
        # The usual blade on the flat bed: what C begins with.
        live.start(poses[0], blade_width=soil.description.blade_width)
        soil.start(poses[0])
    else:
        contexts = run.step_context.astype(np.float64)
        # Of runs that start alike one start was kept: its context is the nearest.
        case = case if case in live.cases else None
        live.start(poses[0], case=case, context=contexts[0])
        soil.start(poses[0], index=live.start_index, context=contexts[0])
    up, before = soil.description.up_axis, soil.particles()
    every = max(1, len(poses) // PARTICLE_FRAMES)
    rows, same, apart, motion, heights = ([], []), 0, [0.0], [0.0], [0.0]
    to_twin = [(0.0, 0.0)]
    for k, (pose, context) in enumerate(zip(poses[1:], contexts[1:], strict=True), 1):
        mine, expected = (_refused(one, pose, context) for one in (soil, live))
        if (mine is None) != (expected is None):
            raise ValueError(f'frame {k} is refused by {"C" if mine is None else "Python"} alone')
        if mine is None:  # a place under the floor, say
            break
        for found, frame in zip(rows, (mine, expected)):
            found.append(np.stack([frame.force, frame.torque]))
        same += (mine.status == 0) == (expected.now == RolloutStatus.OK)
        heights.append(abs(mine.point[up] - expected.pose[up]))
        if k % every == 0:
            points = expected.particles()
            mine, twin = soil.particles(), twin_particles(expected.soil)
            apart.append(np.abs(mine - points).max())
            to_twin.append((np.abs(mine - twin).max(), np.abs(points - twin).max()))
            motion.append(np.abs(points - before).max())
    force = torque = 0.0
    if rows[0]:  # a wheel may be refused at once, where both find it under the floor
        mine, theirs = (np.array(found) for found in rows)
        size = np.maximum(np.abs(theirs).max(axis=(0, 2)), 1e-12)
        force, torque = np.abs(mine - theirs).max(axis=(0, 2)) / size
    return {
        'frames': len(rows[0]),
        'motion': float(max(apart) / max(motion)) if max(motion) > 0 else float(max(apart)),
        'force': float(force),
        'torque': float(torque),
        'height_m': float(max(heights)),
        'particles_m': float(max(apart)),
        'c_to_twin_m': float(max(c for c, _ in to_twin)),
        'python_to_twin_m': float(max(python for _, python in to_twin)),
        'same_status': same,
    }


def twin_particles(soil) -> np.ndarray:
    """float64 [N, 3], m: the particles of a `SweptSoil` with the networks in float64 numpy.

    Their inputs and shares are those of TensorFlow, in float32.
    """
    swept, field = soil.swept, soil.of.field
    network, local, members = field.network, swept.ground.local, soil.of.members
    of_frame = swept.frame.bins, swept.frame.scalars, local[None]
    values = network.inputs.particles(*of_frame).numpy()[0].astype(np.float64)[None]
    for i, (weight, bias) in enumerate(network.soil.layers):
        if i:
            values = values / (1.0 + np.exp(-values))  # silu
        values = values @ weight.numpy()[:members].astype(np.float64)
        values += bias.numpy()[:members]
    gate = network.inputs.gate(*of_frame).numpy()[0].astype(np.float64)
    moved = network.inputs.displacement * gate[:, None] * values.mean(axis=0)
    moved[:, 2] *= np.clip(local[:, 2] / ACROSS, -1.0, 1.0)
    there = swept.ground.places + moved
    there += field.tool.inside(there, swept.pose, swept.ground.size)[1]
    return swept.ground.points + field.axes.world(there - swept.ground.places)


def _refused(stepper, pose, context):
    """A frame, or None where the pose is refused."""
    try:
        return stepper.step(pose, context=context)
    except ValueError:
        return None


def measure(model_path: str, data_path: str, limit: int = 0) -> list[dict]:
    """One row for each test run: `play` or `play_field`, with its `record`, `kind` and `case`.

    Args:
      model_path, data_path: a model that has a C form, and its dataset.
      limit: only so many runs, spread over test; 0: all.

    Raises:
      FileNotFoundError, ValueError: no model or dataset there, or no C form.
      library.NoCompiler: there is no C compiler.
    """
    if checkpoints.read_config(model_path)['config'].get('model') == 'swept_field':
        field, parts = field_data.read(model_path)
        live = Stepper(FieldEngine(field, *live_starts.read(model_path)))
        soil = CField.of(field, **parts)
        cases = dataset.read_metadata(data_path).get('cases', {}).get('test', [])
        runs, rows = dataset.read_split(data_path, 'test'), []
        for record in splits.spread_over(len(runs), limit):
            case = cases[record] if record < len(cases) else {}
            row = play_field(soil, live, runs[record], case.get('case'))
            named = {'record': record, 'kind': case.get('kind'), 'case': case.get('case')}
            rows.append(named | row)
        return rows
    model, n, space, found = starts.read_model(model_path, data_path)
    soil = CSubspace.of(model, n, space, starts=found)
    groups = registry.open_model(model_path, data_path, 'test').groups
    runs = [group.select(run) for group in groups for run in range(len(group.position))]
    return [
        {'record': int(runs[i].record[0])} | play(soil, model, space, runs[i])  # type: ignore[attr-defined]
        for i in splits.spread_over(len(runs), limit)
    ]


def run(values) -> None:
    """Runs the command with its flags."""
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
    flags.DEFINE_list(
        'models', [*(f'models/{s}/{n}' for s in ('excavation', 'wheel')
                     for n in ('pcg', 'pcg_thesis', 'fcg_original')),
                   *(f'models/{s}_v2/swept_field' for s in ('excavation', 'wheel'))],
        'Model folders.',
    )  # fmt: skip
    flags.DEFINE_string('data_root', 'datasets', 'Folder of the datasets, named as the scenes.')
    flags.DEFINE_string('output', None, 'JSON file for the figures; other models in it stay.')
    command.start(run)
