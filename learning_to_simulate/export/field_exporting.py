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
# run, and of particles, m. Measured on 14 test runs 3e-6 (force), 1e-5 (torque, bound) and 8e-6 m.
TOLERANCE = 1e-4
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
    live = LiveField(field, starts, None, members)
    run = dataset.read_split(data_path, 'test')[0]
    cases = dataset.read_metadata(data_path).get('cases', {}).get('test', [])
    width = field.tool.size(field.axes, next(iter(cases), {}))[0]
    points = field.rest
    if subspace is not None:
        points = subspace.decode(run.position[0, run.n_rigid :][: subspace.n_modes])

    def write_and_compare(loaded, kind, folder):
        bed = start_inputs(field, starts.pose[starts.index(None)], field.rest, field.blade.width)
        rest = field.rest[_kept(functions)].astype(np.float32)
        files.write_npz(os.path.join(folder, BED_FILE), **bed, rest=rest)
        poses = run.rigid_pose.astype(np.float64)
        return compare(functions, loaded, live, poses, points, float(width))

    return functions, write_and_compare


def pose_inputs(pose) -> dict[str, np.ndarray]:
    """`pose` and `position_low` of a pose [7], float64."""
    high = np.asarray(pose, np.float32)
    return {'pose': high, 'position_low': (pose - high.astype(np.float64))[:3].astype(np.float32)}


def start_inputs(field, pose, bed, width: float, velocity=None) -> dict[str, np.ndarray]:
    """All inputs of `FieldFunctions.start`.

    Args:
      field: `SweptField` of a blade.
      pose: float64 [7] of the tool.
      bed: [N, 3] particles, m, or a `beds.HeightMap`.
      width: of the blade, m.
      velocity: [6], see `LiveField.start`; None: at rest.
    """
    plane = field.axes.poses(pose)
    ground, read = beds.ground(field, plane, np.array([width]), bed)
    values = {
        'velocity': np.zeros(6) if velocity is None else velocity,
        'width': width,
        'surface': read.surface[0],
        'level': read.level[0],
        'end': read.end[0] - plane[0],
        'floor': ground.places[:, 1].min() - field.spacing / 2,
    }
    values = {name: np.asarray(value, np.float32) for name, value in values.items()}
    return pose_inputs(pose) | values


def compare(functions: FieldFunctions, loaded, live, poses, bed, width: float, dt=None) -> dict:
    """Differences to the source over a path, and times per call.

    Args:
      functions: that were written.
      loaded: name -> function, as they were read again.
      live: `LiveField` of the same members.
      poses: float64 [T, 7].
      bed: [N, 3] particles, m, or a `beds.HeightMap`.
      width: of the blade, m.
      dt: between the poses, s; None for that of the training.

    Raises:
      ValueError: a difference above its tolerance, or a frame that one of them judges otherwise.
    """
    dt = live.dt if dt is None else dt
    velocity = velocity_between(poses[0], poses[1], dt)
    live.start(poses[0], velocity, bed=bed, blade_width=width)
    kept = _kept(functions)
    rest = live.state.ground.points[kept].astype(np.float32)
    begun = _called(loaded['start'], start_inputs(functions.field, poses[0], bed, width, velocity))
    state, seconds = {name: begun[name] for name in ('bins', 'tool')}, []
    shown = np.linspace(1, len(poses) - 1, PARTICLE_FRAMES).astype(int)
    found: dict[str, list] = {name: [] for name in ('force', 'torque', 'bound')}
    expected: dict[str, list] = {name: [] for name in found}
    apart, particle_seconds = [0.0], []
    for k, pose in enumerate(poses[1:], start=1):
        clock = time.perf_counter()
        out = _called(loaded['step'], state | pose_inputs(pose) | {'dt': np.float32(dt)})
        seconds.append(time.perf_counter() - clock)
        state = {name: out[f'next_{name}'] for name in state}
        try:
            frame = live.step(pose, dt=dt)
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
    bad = {n: d for n, d in differences.items() if not d <= TOLERANCE}
    if not max(apart) <= PARTICLES_TOLERANCE:
        bad['particles_m'] = max(apart)
    if bad:
        raise ValueError(
            f'the exported model differs from its source by {bad}, more than {TOLERANCE:g} of the '
            f'largest load or {PARTICLES_TOLERANCE:g} m; nothing was written'
        )
    return values


def _kept(functions):
    """Which particles of the bed at rest are the P of `particles`."""
    return splits.spread_over(len(functions.field.rest), functions.n_particles)


def _called(function, inputs):
    """Outputs as arrays; inputs of no axis as arrays too, which all formats take."""
    arrays = {name: np.asarray(value) for name, value in inputs.items()}
    return {name: np.asarray(value) for name, value in function(**arrays).items()}


def _share(found, expected):
    """Largest difference over the largest magnitude; 0 / 0 counts as 0."""
    apart = np.abs(np.array(found, np.float64) - np.array(expected, np.float64)).max()
    size = np.abs(np.array(expected)).max()
    return float(apart / size) if size > 0 else float(apart)
