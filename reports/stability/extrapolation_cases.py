"""Tools faster, deeper, steeper or heavier than in training: does the model say so, is it right?

The blade's motion is a closed form of depth, speed and angle, the wheel's of its turn and travel,
so runs outside the training range cost nothing. No truth is beside them: these models are of data
version 1, whose particles and forces are not those of the solver since then. How far models of the
data of record are off out there: `reports swept_field --beside`, on the paths of docs/beyond.
"""

import dataclasses

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from mpm import bodies, scenes
from mpm.motions import grid
from reports.stability import shipped as lib
from reports.stability.cases import FLAGGED, HOLDS, Case

PART = 'Outside the training range'
# A case in the middle of the grid; what is swept goes from there to twice the largest of training.
BASE = {'depth_m': 0.05, 'speed_m_s': 0.08, 'angle_deg': 10.0, 'motion': 2}
TRAINED = {'depth_m': 0.10, 'speed_m_s': 0.15, 'angle_deg': 45.0}
SWEEPS = {
    'depth_m': (0.05, 0.10, 0.125, 0.15, 0.20),
    'speed_m_s': (0.08, 0.15, 0.1875, 0.225, 0.30),
    # The solver's blade leans by 60 degrees at most.
    'angle_deg': (10.0, 45.0, 50.0, 55.0, 60.0),
}
WHEEL_FACTORS = {'turn and travel': (1.0, 1.5, 2.0), 'load': (1.0, 2.0, 4.0)}


def blade_points(parameters, n_frame):
    """Sample points [T, R, 3] of a blade, as the scene defines it but without its limits."""
    drive = grid.make_drive(scenes.EXCAVATION, parameters)
    poses = drive.pose(np.arange(n_frame) / scenes.FRAME_RATE)
    return np.array([bodies.sample_points(drive.body, *pose) for pose in poses])


def _lowest(points, count):
    """The nodes that the model takes of a blade: see `reading_utils.read_groups`."""
    order = np.argsort(points[0, :, 1], kind='stable')
    return points[:, np.sort(order[: count or len(order)])]


def blade_group(model, points):
    """A one-run group of a blade's points, on soil that rests in its packing."""
    body = _lowest(points, model.model.simulator.config.rigid_particles)
    rest = model.group.position[:1, :1, model.group.n_rigid :]
    modes = np.repeat(rest, len(points), axis=1)[0]
    position = np.concatenate([body, modes], axis=1)[None]
    group = model.group.take([0])
    return dataclasses.replace(
        group,
        position=position,
        force=np.zeros((1, len(points), 3)),
        body=None,
        kept=None,
    )


def wheel_group(model, travel=1.0, load=1.0):
    """The first test run with its turn and travel faster after the first H frames, or its load."""
    group = model.group.take([0])
    case = model.metadata['cases']['test'][int(group.record[0])]
    drive = grid.make_drive(scenes.WHEEL, case)
    n_frame = group.position.shape[1]
    times = np.arange(n_frame) / scenes.FRAME_RATE
    faster = times + (travel - 1) * np.maximum(times - times[H - 1], 0.0)
    height = group.position[0, :, : group.n_rigid, 1].mean(axis=1)
    points = np.array(
        [
            bodies.sample_points(drive.body, x, y, theta)
            for (x, _, theta), y in zip(drive.pose(faster), height)
        ]
    )
    position = group.position.copy()
    position[0, :, : group.n_rigid] = points
    context = group.context.copy()
    context[..., model.model.simulator.scene.context_names.index('load')] *= load
    return dataclasses.replace(group, position=position, context=context, body=None, kept=None)


def _row(model, function, group, name, is_inside):
    """Row and curve of one altered run: how far the soil moves, and what the status says."""
    position, force, judgements = lib.roll(model, function, group)
    judgement = judgements[0]
    modes = position[:, :, group.n_rigid :]
    moved = 1e3 * model.soil_rms(modes[0, -1] - group.position[0, H - 1, group.n_rigid :])
    mean_force = float(np.linalg.norm(force[0], axis=-1).mean())
    note = f'mean force {mean_force:.3g} N; {judgement.reason or "inside the training range"}'
    row = Case(
        PART,
        f'{model.name}: {name}: RMS way of the soil',
        float(moved),
        'mm',
        None,
        HOLDS if judgement.status == 'ok' else FLAGGED,
        f'{judgement.status}; {note}',
    )
    curve = {
        'model': model.name,
        'moved_mm': moved,
        'force_N': mean_force,
        'status': str(judgement.status),
        'inside': is_inside,
    }
    return row, curve


def sweeps(model, function, progress):
    """Rows and curves of all sweeps of one model."""
    rows, curves = [], []
    if model.scene == 'excavation':
        n_frame = model.group.position.shape[1]
        jobs = [(key, value) for key, values in SWEEPS.items() for value in values]
        for key, value in progress(jobs):
            group = blade_group(model, blade_points(BASE | {key: value}, n_frame))
            inside = value <= TRAINED[key]
            row, curve = _row(model, function, group, f'{key} {value:g}', inside)
            rows.append(row)
            curves.append(curve | {'key': key, 'value': value, 'trained': TRAINED[key]})
        return rows, curves
    for key, factors in WHEEL_FACTORS.items():
        for factor in progress(factors):
            group = wheel_group(model, *((factor, 1.0) if key != 'load' else (1.0, factor)))
            row, curve = _row(model, function, group, f'{key} x {factor:g}', factor == 1.0)
            rows.append(row)
            curves.append(curve | {'key': key, 'value': factor, 'trained': 1.0})
    return rows, curves


def run_all(is_quick, progress):
    """All rows and the curves by name."""
    rows, curves = [], []
    presets = ('pcg',) if is_quick else lib.PRESETS
    models = [lib.load('excavation', preset) for preset in presets]
    functions = [model.function() for model in models]
    wheel = lib.load('wheel', 'pcg')
    for model, function in zip([*models, wheel], [*functions, wheel.function()]):
        new, curve = sweeps(model, function, progress)
        rows += new
        curves += curve
    return rows, {'extrapolation': curves}
