"""A swept field that is exported: the bed beside it, and how it compares with its source.

What was written follows a whole recorded run, the state from step to step, beside `LiveField`, the
stepper of Python in float64.
"""

import os
import time

import numpy as np

from learning_to_simulate.export.field_functions import FieldFunctions
from learning_to_simulate.export.field_state import STATUS
from learning_to_simulate.live import resting_start
from learning_to_simulate.live.path_rollout import velocity_between
from learning_to_simulate.methods.swept_field import beds, model_files
from learning_to_simulate.methods.swept_field.live import LiveField
from pca_tools import dataset, files, splits

BED_FILE = 'bed.npz'
# Largest differences to the source over a run: of loads and bound as a share of the largest of the
# run, of the height of a wheel, m, and of particles, m.
# Measured on 14 test runs of a blade 3e-6 (force), 1e-5 (torque, bound) and 8e-6 m (particles); on
# 55 of a wheel 1e-5, 2e-5, 8e-5 (bound: a difference of forces thirty times its size), 3e-7 m
# (height) and 2e-7 m.
TOLERANCE = 1e-4
HEIGHT_TOLERANCE = 1e-6
PARTICLES_TOLERANCE = 8e-5
PARTICLE_FRAMES = 4


def open_field(model_path: str, data_path: str, members=None, n_particles=None):
    """The functions of a model folder, and what writes a bed beside them and compares them.

    Args:
      model_path: a swept field.
      data_path: its dataset; the first test run is followed.
      members, n_particles: of `FieldFunctions`.

    Raises:
      FileNotFoundError, ValueError: no model or dataset there; as `FieldFunctions`.
    """
    field = model_files.load(model_path)
    functions = FieldFunctions(field, members, n_particles)
    starts, subspace = resting_start.read(model_path)
    live = LiveField(field, starts, subspace, members)
    run, case = _compared_run(data_path, live if field.tool.predicts_height else None)
    points, contexts = field.rest, None
    if subspace is not None:
        points = subspace.decode(run.position[0, run.n_rigid :][: subspace.n_modes])
    begin: dict = {'bed': points}
    if field.tool.predicts_height:
        contexts = np.asarray(run.step_context, np.float64)
        begin |= {'context': contexts[0], 'case': case.get('case')}
    else:
        begin['blade_width'] = field.tool.size(field.axes, case)[0]

    def write_and_compare(loaded, kind, folder):
        live.start()
        pose, ground, context = live.state.frame.pose, live.state.ground, live.state.context
        bed = start_inputs(functions, pose, ground.points, ground.size, context=context)
        rest = ground.points[_kept(functions, ground)].astype(np.float32)
        files.write_npz(os.path.join(folder, BED_FILE), **bed, rest=rest)
        poses = run.rigid_pose.astype(np.float64)
        return compare(functions, loaded, live, poses, begin, contexts)

    return functions, write_and_compare


def _compared_run(data_path, live):
    """The first test run and its case; of a wheel the first whose body its `LiveField` has."""
    runs = dataset.read_split(data_path, 'test')
    cases = dataset.read_metadata(data_path).get('cases', {}).get('test', []) or [{}]
    pairs = zip(runs, cases)
    return next((x for x in pairs if live is None or x[1].get('case') in live.cases), (runs[0], {}))


def pose_inputs(functions: FieldFunctions, pose) -> dict[str, np.ndarray]:
    """`pose`, `position_low` and, where the tool asks for it, `rotation_low` of a pose [7],
    float64."""
    high = np.asarray(pose, np.float32)
    low = (pose - high.astype(np.float64)).astype(np.float32)
    values = {'pose': high, 'position_low': low[:3], 'rotation_low': low[3:]}
    return {name: values[name] for name in functions.pose_shapes}


def start_inputs(
    functions: FieldFunctions, pose, bed, size, velocity=None, context=None
) -> dict[str, np.ndarray]:
    """All inputs of `FieldFunctions.start`.

    Args:
      functions: of the field.
      pose: float64 [7] of the tool.
      bed: [N, 3] particles, m, or a `beds.HeightMap`.
      size: float64 [S] of the tool: the width of a blade, m; radius and width of a wheel, m,
        gravity, m/s2, and tan of the friction angle.
      velocity: [6], see `LiveField.start`; None: at rest.
      context: float64 [C] of a wheel, in the order of the scene's `context_names`.
    """
    field = functions.field
    plane = field.axes.poses(pose)
    ground, read = beds.ground(field, plane, size, bed)
    values: dict = {
        'velocity': np.zeros(6) if velocity is None else velocity,
        'surface': read.surface[0],
        'level': read.level[0],
        'end': read.end[0] - plane[0],
        'floor': ground.places[:, 1].min() - field.spacing / 2,
        **functions.form.own_inputs(size, context),
    }
    values = {name: np.asarray(value, np.float32) for name, value in values.items()}
    return pose_inputs(functions, pose) | values


def compare(
    functions: FieldFunctions, loaded, live, poses, begin: dict, contexts=None, dt=None
) -> dict:
    """Differences to the source over a path, and times per call.

    Args:
      functions: that were written.
      loaded: name -> function, as they were read again.
      live: `LiveField` of the same members.
      poses: float64 [T, 7].
      begin: further arguments of `LiveField.start`; the bed among them.
      contexts: float64 [T, C] of a wheel.
      dt: between the poses, s; None for that of the training.

    Raises:
      ValueError: a difference above its tolerance, or a frame that one of them judges otherwise.
    """
    dt = live.dt if dt is None else dt
    velocity = velocity_between(poses[0], poses[1], dt)
    live.start(poses[0], velocity, **begin)
    ground, context, up = live.state.ground, live.state.context, functions.field.axes.up
    kept = _kept(functions, ground)
    rest = ground.points[kept].astype(np.float32)
    given = start_inputs(functions, poses[0], begin['bed'], ground.size, velocity, context)
    begun = _called(loaded['start'], given)
    state, seconds = {name: begun[name] for name in ('bins', 'tool')}, []
    shown = np.linspace(1, len(poses) - 1, PARTICLE_FRAMES).astype(int)
    found: dict[str, list] = {name: [] for name in ('force', 'torque', 'bound')}
    expected: dict[str, list] = {name: [] for name in found}
    apart, heights_apart, particle_seconds = [0.0], [0.0], []
    for k, pose in enumerate(poses[1:], start=1):
        coming = pose_inputs(functions, pose) | {'dt': np.float32(dt)}
        if contexts is not None:
            context = contexts[k]
            coming['context'] = context.astype(np.float32)
        clock = time.perf_counter()
        out = _called(loaded['step'], state | coming)
        seconds.append(time.perf_counter() - clock)
        state = {name: out[f'next_{name}'] for name in state}
        try:
            frame = live.step(pose, context, dt)
            status = STATUS[str(frame.now)]
        except ValueError:
            status = STATUS['refused']
        if int(out['status']) != status:
            names = {number: name for name, number in STATUS.items()}
            raise ValueError(
                f'frame {k} is {names[int(out["status"])]!r} in the exported model and '
                f'{names[status]!r} in its source; nothing was written'
            )
        if status == STATUS['refused']:
            break
        if 'height' in out:
            heights_apart.append(float(np.abs(out['height'] - frame.pose[up])))
        for name in found:
            if name in out:
                found[name].append(out[name])
                expected[name].append(getattr(frame, name))
        if k in shown:
            clock = time.perf_counter()
            there = _called(loaded['particles'], state | {'rest': rest})['particles']
            particle_seconds.append(time.perf_counter() - clock)
            apart.append(float(np.abs(there - frame.particles()[kept]).max()))
    if not found['force']:
        raise ValueError('the model takes no frame of the run that it is compared on')
    differences = {n: _share(found[n], expected[n]) for n in found if found[n]}
    values = {
        'steps': len(found['force']),
        'relative_difference': differences,
        'tolerance': TOLERANCE,
        'first_call_s': seconds[0],
        'ms_per_step_median': 1e3 * float(np.median(seconds)),
        'particles_difference_m': max(apart),
        'particles_tolerance_m': PARTICLES_TOLERANCE,
        'ms_per_particles': 1e3 * min(particle_seconds, default=0.0),
    }
    if functions.field.tool.predicts_height:
        values['height_difference_m'] = max(heights_apart)
        values['height_tolerance_m'] = HEIGHT_TOLERANCE
    bad = {n: d for n, d in differences.items() if not d <= TOLERANCE}
    if not max(apart) <= PARTICLES_TOLERANCE:
        bad['particles_m'] = max(apart)
    if not max(heights_apart) <= HEIGHT_TOLERANCE:
        bad['height_m'] = max(heights_apart)
    if bad:
        raise ValueError(
            f'the exported model differs from its source by {bad}, more than {TOLERANCE:g} of the '
            f'largest load, {PARTICLES_TOLERANCE:g} m of particles or {HEIGHT_TOLERANCE:g} m of '
            f'height; nothing was written'
        )
    return values


def _kept(functions, ground):
    """Which particles of a bed are the P of `particles`."""
    return splits.spread_over(len(ground.points), functions.n_particles)


def _called(function, inputs):
    """Outputs as arrays; inputs of no axis as arrays too, which all formats take."""
    arrays = {name: np.asarray(value) for name, value in inputs.items()}
    return {name: np.asarray(value) for name, value in function(**arrays).items()}


def _share(found, expected):
    """Largest difference over the largest magnitude; 0 / 0 counts as 0."""
    apart = np.abs(np.array(found, np.float64) - np.array(expected, np.float64)).max()
    size = np.abs(np.array(expected)).max()
    return float(apart / size) if size > 0 else float(apart)
