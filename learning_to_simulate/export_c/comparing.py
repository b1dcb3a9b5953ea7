"""Compares what was exported with the model that it came from."""

import os
import tempfile

import numpy as np

from learning_to_simulate import registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.export_c import c_library, project
from learning_to_simulate.export_c.c_field import CField
from learning_to_simulate.export_c.c_soil import CSoil
from learning_to_simulate.live import stepping
from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.swept_field.network import ACROSS
from pca_tools import dataset

# Largest difference to TensorFlow as a share of the motion, or of the largest force. Measured 1e-7
# to 5e-6. Where all of the body's motion is predicted, a rounding of its velocity lasts, and
# TensorFlow itself is up to 3e-4 from the same networks in float64.
TOLERANCE = 1e-4
TOLERANCE_OF_PREDICTED = 1e-3
COMPARED_STEPS = 40
# Frames of a swept field whose particles are compared.
PARTICLE_FRAMES = 5


def graph(model_path, data_path, model, n_rigid, subspace, name, values) -> dict:
    """Differences of the compiled project to the TensorFlow stepper over recorded frames.

    Returns:
      `steps`, `kernel`, `relative_difference` by kind, `tolerance` and `particles_difference_m`; or
      `skipped`: why nothing was compared.

    Raises:
      ValueError: a difference above the tolerance.
      c_library.CompileFailed: the project does not compile.
    """
    try:
        soil = _compiled(CSoil, name, values)
    except c_library.NoCompiler as error:
        return {'skipped': str(error)}
    opened = registry.open_model(model_path, data_path, 'test')
    groups = opened.groups
    group = next((g for g in groups if g.n_rigid == n_rigid), None)
    if group is None:
        return {'skipped': f'no test run has {n_rigid} rigid nodes'}
    steppers = soil, stepping.Stepper(model, n_rigid, subspace)
    nodes, forces, particles = ([], []), ([], []), []
    motion = model.simulator.scene.rigid_motion
    for stepper in steppers:
        stepper.reset(group.position[0, :H], group.context_at(H, 0))
    poses = group.position[0, H : H + COMPARED_STEPS, :n_rigid]
    for k, pose in enumerate(poses, H):
        context = group.context_at(k, 0) if group.context_changes else None
        for stepper, of_nodes, of_force in zip(steppers, nodes, forces):
            frame = stepper.step(pose if motion.is_known else None, context)
            of_nodes.append(np.concatenate([frame.rigid_pose, frame.modes]))
            of_force.append(np.zeros(3) if frame.force is None else frame.force)
        if subspace is not None:
            particles.append(np.abs(np.subtract(*(s.particles() for s in steppers))).max())
    return _judged(
        soil.kernel,
        len(nodes[0]),
        max(particles, default=0.0),
        TOLERANCE_OF_PREDICTED if motion is RigidMotion.PREDICTED else TOLERANCE,
        position=_share(*nodes, group.position[0, H - 1]),
        force=_share(*forces, 0.0),
    )


def field(live, data_path: str, name: str, values: dict) -> dict:
    """The same for a swept field: the first test run, against its stepper in Python.

    Args:
      live: `LiveField` of the model.
      data_path, name, values: as of `graph`.
    """
    try:
        soil = _compiled(CField, name, values)
    except c_library.NoCompiler as error:
        return {'skipped': str(error)}
    run = dataset.read_split(data_path, 'test')[0]
    if run.rigid_pose is None:
        return {'skipped': 'the first test run holds no pose of its tool'}
    case = dataset.read_metadata(data_path).get('cases', {}).get('test', [{}])[0].get('case')
    row = play_field(soil, live, run, case, max(1, len(run.rigid_pose) // PARTICLE_FRAMES))
    return _judged(
        soil.kernel,
        row['frames'],
        row['particles_m'],
        TOLERANCE,
        position=row['particles_m'] / row['motion_m'] if row['motion_m'] else row['particles_m'],
        force=row['force'],
    )


def play_field(soil: CField, live, run, case: int | None, every: int) -> dict:
    """Largest differences of a swept field in C to Python over a recorded run.

    Args:
      soil: in C.
      live: `LiveField` of the same model.
      run: `dataset.Run` with poses.
      case: of the run, where a wheel begins.
      every: so many frames the particles are compared.

    Raises:
      ValueError: a frame that one of them refuses and the other does not.

    Returns:
      `frames` until the first that both refuse; `force` and `torque`, shares of the largest;
      `height_m`, `particles_m`, `motion_m` of the particles; `c_to_twin_m` and `python_to_twin_m`,
      of the particles to `twin_particles`; `same_status`, in how many frames.
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
            mine, twin = soil.particles(), twin_particles(live.soil, expected.modes)
            apart.append(np.abs(mine - points).max())
            to_twin.append((np.abs(mine - twin).max(), np.abs(points - twin).max()))
            motion.append(np.abs(points - before).max())
    force = torque = 0.0
    if rows[0]:  # a wheel may be refused at once, where both find it under the floor
        force, torque = (_share(*(np.array(found)[:, i] for found in rows), 0.0) for i in range(2))
    return {
        'frames': len(rows[0]),
        'force': force,
        'torque': torque,
        'height_m': float(max(heights)),
        'particles_m': float(max(apart)),
        'motion_m': float(max(motion)),
        'c_to_twin_m': float(max(c for c, _ in to_twin)),
        'python_to_twin_m': float(max(python for _, python in to_twin)),
        'same_status': same,
    }


def twin_particles(soil, swept) -> np.ndarray:
    """float64 [N, 3], m: `FieldSoil.particles` of a `Swept` with the networks in float64 numpy.

    Their inputs and shares are those of TensorFlow, in float32.
    """
    field, ground = soil.field, swept.ground
    network, local = field.network, ground.local
    of_frame = swept.frame.bins, swept.frame.scalars, local[None]
    values = network.inputs.particles(*of_frame).numpy()[0].astype(np.float64)[None]
    for i, (weight, bias) in enumerate(network.soil.layers):
        if i:
            values = values / (1.0 + np.exp(-values))  # silu
        values = values @ weight.numpy()[: soil.members].astype(np.float64)
        values += bias.numpy()[: soil.members]
    gate = network.inputs.gate(*of_frame).numpy()[0].astype(np.float64)
    moved = network.inputs.displacement * gate[:, None] * values.mean(axis=0)
    moved[:, 2] *= np.clip(local[:, 2] / ACROSS, -1.0, 1.0)
    there = ground.places + moved
    there += field.tool.inside(there, swept.pose, ground.size)[1]
    return ground.points + field.axes.world(there - ground.places)


def _refused(stepper, pose, context):
    """A frame, or None where the pose is refused."""
    try:
        return stepper.step(pose, context=context)
    except ValueError:
        return None


def _compiled(kind, name, values):
    """A run of a model in a library of its own, as its users will have it."""
    with tempfile.TemporaryDirectory() as folder:
        project.write(folder, name, values)
        library = os.path.join(folder, 'model.so')
        c_library.compile_sources(library, folder)
        return kind.open(library, name)


def _judged(kernel, steps, particles, tolerance, **difference):
    bad = {k: v for k, v in difference.items() if not v <= tolerance}
    if bad:
        raise ValueError(
            f'the C code differs from the model by {bad}, more than {tolerance:g} of the motion or '
            f'force; nothing was written'
        )
    return {
        'steps': steps,
        'kernel': kernel,
        'relative_difference': difference,
        'tolerance': tolerance,
        'particles_difference_m': float(particles),
    }


def _share(values, expected, start):
    """Largest difference over the largest distance from the start; 0 / 0 counts as 0."""
    apart = np.abs(np.subtract(values, expected)).max()
    size = np.abs(np.subtract(expected, start)).max()
    return float(apart / size) if size > 0 else float(apart)
