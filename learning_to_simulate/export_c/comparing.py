"""Compares what was exported with the model that it came from."""

import os
import tempfile

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.export_c import c_library, project
from learning_to_simulate.export_c.c_field import CField
from learning_to_simulate.export_c.c_soil import CSoil
from learning_to_simulate.live import stepping
from learning_to_simulate.methods import registry
from learning_to_simulate.methods.swept_field import episodes, soil_physics, tool_path
from learning_to_simulate.methods.swept_field.tool_path import Bed, Frame
from pca_tools import dataset

# Largest difference to TensorFlow as a share of the motion, or of the largest force. Measured 1e-7
# to 5e-6.
TOLERANCE = 1e-4
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
    """
    opened = registry.open_model(model_path, data_path, 'test')
    groups = opened.groups
    group = next((g for g in groups if g.n_rigid == n_rigid), None)
    if group is None:
        return {'skipped': f'no test run has {n_rigid} rigid nodes'}
    try:
        soil = _compiled(CSoil, name, values)
    except c_library.NoCompiler as error:
        return {'skipped': str(error)}
    steppers = soil, stepping.Stepper(model, n_rigid, subspace)
    nodes, forces, particles = ([], []), ([], []), []
    known = model.simulator.scene.rigid_motion.is_known
    for stepper in steppers:
        stepper.reset(group.position[0, :H], group.context_at(H, 0))
    poses = group.position[0, H : H + COMPARED_STEPS, :n_rigid]
    for k, pose in enumerate(poses, H):
        context = group.context_at(k, 0) if group.context_changes else None
        for stepper, of_nodes, of_force in zip(steppers, nodes, forces):
            frame = stepper.step(pose if known else None, context)
            of_nodes.append(np.concatenate([frame.rigid_pose, frame.modes]))
            of_force.append(np.zeros(3) if frame.force is None else frame.force)
        if subspace is not None:
            particles.append(np.abs(np.subtract(*(s.particles() for s in steppers))).max())
    return _judged(
        soil.kernel,
        len(nodes[0]),
        max(particles, default=0.0),
        position=_share(*nodes, group.position[0, H - 1]),
        force=_share(*forces, 0.0),
    )


def field(swept, data_path: str, name: str, values: dict) -> dict:
    """The same for a swept field: the first test run, against its networks in TensorFlow."""
    try:
        soil = _compiled(CField, name, values)
    except c_library.NoCompiler as error:
        return {'skipped': str(error)}
    poses = dataset.read_split(data_path, 'test')[0].rigid_pose
    if poses is None:
        return {'skipped': 'the first test run holds no pose of its tool'}
    poses = poses.astype(np.float64)
    plane, width = swept.axes.poses(poses), np.array([swept.blade.width])
    reader = episodes.BedReader(swept.axes, swept.grid, swept.kept_spacing, swept.spacing)
    surface, level, end = reader.read(swept.rest, plane[0, 0], width[0])
    bed = Bed(surface[None], np.array([level]), np.array([end]))
    state = tool_path.start(swept.grid, bed, plane[:1])
    frames = []
    for pose in plane[1:]:
        state = tool_path.advance(swept.grid, state, pose[None], swept.scene.dt)
        frames.append(tool_path.frame(swept.grid, bed, width, state))
    seen = Frame(*(np.concatenate(part) for part in zip(*frames)))
    force, torque = swept.axes.world_loads(swept.loads(seen).mean(axis=0))
    some = np.unique(np.linspace(1, len(frames) - 1, PARTICLE_FRAMES).astype(int))
    local = swept.axes.points(swept.rest) - [plane[0, 0], level, 0.0]
    moved = swept.displacement(Frame(seen.bins[some], seen.scalars[some]), local).mean(axis=0)
    soil.start(poses[0])
    of_c, particles, motion = [], [], []
    for k, pose in enumerate(poses[1:]):
        of_c.append(np.concatenate(soil.step(pose)[:2]))
        if k not in some:
            continue
        shift = moved[list(some).index(k)]
        there = swept.axes.points(swept.rest) + shift
        now = shift.any(axis=1)
        there[now] = soil_physics.pushed_out(there[now], plane[k + 1], swept.blade, width[0])
        particles.append(np.abs(swept.axes.points(soil.particles()) - there).max())
        motion.append(np.abs(shift).max())
    loads = np.concatenate([force, torque], axis=1)
    return _judged(
        soil.kernel,
        len(of_c),
        max(particles),
        position=max(particles) / max(motion) if max(motion) > 0 else max(particles),
        force=_share(np.array(of_c), loads, 0.0),
    )


def _compiled(kind, name, values):
    """A run of a model in a library of its own, as its users will have it."""
    with tempfile.TemporaryDirectory() as folder:
        project.write(folder, name, values)
        library = os.path.join(folder, 'model.so')
        c_library.compile_sources(library, folder)
        return kind.open(library, name)


def _judged(kernel, steps, particles, **difference):
    bad = {k: v for k, v in difference.items() if not v <= TOLERANCE}
    if bad:
        raise ValueError(
            f'the C code differs from the model by {bad}, more than {TOLERANCE:g} of the motion or '
            f'force; nothing was written'
        )
    return {
        'steps': steps,
        'kernel': kernel,
        'relative_difference': difference,
        'tolerance': TOLERANCE,
        'particles_difference_m': float(particles),
    }


def _share(values, expected, start):
    """Largest difference over the largest distance from the start; 0 / 0 counts as 0."""
    apart = np.abs(np.subtract(values, expected)).max()
    size = np.abs(np.subtract(expected, start)).max()
    return float(apart / size) if size > 0 else float(apart)
