"""A machine of springs and a mass on the soil, over a range of communication steps.

The tool of a mass M hangs on a carriage by springs and dampers along the way and upwards (a body
whose height is predicted: along the way only). The carriage takes the path of a recorded test run.
Machine and soil exchange place, velocity and force once per step and know nothing of each other in
between, by the calls that the FMU makes (`lts_advance`, `lts_field_advance`): the force that the
soil gives is held over the coming step, and the soil takes the tool to keep its velocity.

Example:
  python -m learning_to_simulate.export_c.coupled --output=docs/c/coupled.json
"""

import ctypes
import os
from typing import NamedTuple

import numpy as np
from absl import flags
from scipy.spatial.transform import Rotation

from learning_to_simulate import checkpoints, command, registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.export_c import c_header, c_library, c_stepper, starts
from learning_to_simulate.export_c.c_field import CField
from learning_to_simulate.live import poses
from pca_tools import dataset, files, rigid_fit

STEPS = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2, 3, 6)  # communication steps in frames
MASS, DAMPING = 50.0, 0.2  # kg; share of the critical damping
STIFFNESS = (1e4, 5e4, 2e5)  # N/m; 2.3, 5 and 10 Hz
MACHINE_STEP = 1e-4  # s, at most, of the machine between two exchanges
# A run is stable where the springs are never longer than so many times what the reference needs.
STABLE = 1.5


class Soil(NamedTuple):
    """A model at the beginning of a recorded run.

    Attributes:
      begin: () -> None, starts at the first pose of the path.
      advance: (h, pose [7], velocity [6]) -> (force [3] N, status); a negative status is an error.
      path: float64 [n_frame, 7] poses of the carriage.
      velocity: float64 [n_frame - 1, 6] from each of them to the next, m/s and rad/s.
      dt: s, of a frame.
      axes: of the world along which the tool may leave the carriage.
    """

    begin: object
    advance: object
    path: np.ndarray
    velocity: np.ndarray
    dt: float
    axes: tuple[int, ...]


def open_soil(model_path: str, data_path: str, run: int = 0) -> Soil:
    """A model with the path of a test run.

    Args:
      model_path, data_path: a model with a given body that has a C form, and its dataset.
      run: number of the test run.

    Raises:
      FileNotFoundError, ValueError: no model or dataset there, or a body that is not given.
      c_library.NoCompiler: there is no C compiler.
    """
    if checkpoints.read_config(model_path)['config'].get('model') == 'swept_field':
        return of_field(
            CField.load(model_path), dataset.read_split(data_path, 'test')[run].rigid_pose
        )
    model, n, subspace, found = starts.read_model(model_path, data_path)
    scene = model.simulator.scene
    if not scene.rigid_motion.is_known:
        raise ValueError(f'{model_path}: the body is {scene.rigid_motion}, it needs a given one')
    group = registry.open_model(model_path, data_path, 'test').groups[0].select(run)
    context = group.context_at(H, 0)
    near = [0.0 if context is None else np.abs(s['context'] - context).max() for s in found]
    start = int(np.argmin(near))
    points = found[start]['points']
    path = np.array([_pose(points, nodes[:n]) for nodes in group.position[0]])
    stepper = c_stepper.CStepper(model, n, subspace, starts=found)
    velocity = _velocities(path, scene.dt)
    axes = (0,) if scene.rigid_motion == 'driven' else (0, scene.up_axis)
    return Soil(
        lambda: stepper.start(start, path[0], velocity[0], context),
        _advance(c_library.load().lts_advance, stepper, 'lts_result'),
        path, velocity, scene.dt, axes,
    )  # fmt: skip


def _pose(points, there):
    """Where the particles of a start are: their centroid, and the rotation from the start."""
    moved = rigid_fit.fit_rigid_motion(points, there)
    return np.concatenate([there.mean(axis=0), poses.quaternion_of(moved.rotation)])


def of_field(soil: CField, path) -> Soil:
    """The same of a swept field in C, with the poses [n_frame, 7] of the carriage or None.

    Raises:
      ValueError: no path.
    """
    if path is None:
        raise ValueError('the test run holds no pose of its tool')
    path, d = np.asarray(path, np.float64), soil.description
    velocity = _velocities(path, d.dt)
    return Soil(
        lambda: soil.start(path[0], velocity[0]),
        _advance(c_library.load().lts_field_advance, soil, 'lts_field_result'),
        path, velocity, d.dt, (d.travel_axis, d.up_axis),
    )  # fmt: skip


def _advance(call, soil, name):
    result, values = c_header.structures()[name](), np.empty((2, 7))
    at = [row.ctypes.data for row in values]

    def advance(h, pose, velocity):
        values[0], values[1, :6] = pose, velocity
        code = call(soil.address, h, *at, ctypes.addressof(result))
        return np.array(result.force), code

    return advance


def _velocities(path, dt):
    """[n_frame - 1, 6] on the way from each frame to the next."""
    turned = Rotation.from_quat(np.roll(path[:, 3:], -1, axis=1))
    turn = (turned[1:] * turned[:-1].inv()).as_rotvec()
    return np.concatenate([np.diff(path[:, :3], axis=0), turn], axis=1) / dt


def drive(soil: Soil, step: float, stiffness: float, seconds: float | None = None) -> dict:
    """Runs machine and soil together.

    Args:
      soil: of `open_soil`.
      step: of the communication, frames.
      stiffness: N/m, of each spring.
      seconds: of the run; None for the whole path.

    Returns:
      `time` [n] s and `force` [n, A] N after each step, along the axes that are free;
      `longest`: m, the largest length of a spring; `error`: what the soil said, or None; `status`:
      bits of all frames.
    """
    path, dt, axes = soil.path, soil.dt, list(soil.axes)
    h, last = step * dt, len(path) - 1
    n = int(round(last / step if seconds is None else seconds / h))
    inner = int(np.ceil(h / MACHINE_STEP))
    damping = 2.0 * DAMPING * np.sqrt(stiffness * MASS)
    soil.begin()
    x, v = path[0, axes], soil.velocity[0, axes]
    force, longest, status, error = np.zeros(len(axes)), 0.0, 0, None
    forces = []
    for k in range(n):
        # Both begin the step with what they know: the machine with the last force of the soil.
        frame = k * step + step / inner * np.arange(inner)
        along = np.minimum((frame + 1e-9).astype(int), last - 1)
        carriage = path[along] + (frame - along)[:, None] * (path[along + 1] - path[along])
        pose, twist = carriage[0].copy(), soil.velocity[along[0]].copy()
        pose[axes], twist[axes] = x, v
        for there, carried in zip(carriage[:, axes], soil.velocity[along][:, axes]):
            v = v + h / inner * (force - stiffness * (x - there) - damping * (v - carried)) / MASS
            x = x + h / inner * v
            longest = max(longest, float(np.abs(x - there).max()))
        world, code = soil.advance(h, pose, twist)
        if code < 0:
            error = c_library.load().lts_error_text(code).decode()
            break
        status |= code
        force = world[axes]
        forces.append(force)
    return {
        'time': h * np.arange(1, len(forces) + 1),
        'force': np.array(forces).reshape(-1, len(axes)),
        'longest': longest,
        'error': error,
        'status': status,
    }


def measure(soil: Soil, steps=STEPS, stiffness=STIFFNESS, seconds: float | None = None) -> list:
    """Runs every machine with every step; the first step is the reference.

    Returns:
      rows of `stiffness`, `step_ms`, `stable`, `longest_mm`, `force_difference` (relative L2 to the
      reference at the ends of whole frames that both have), `error`, `status`.
    """
    rows = []
    for k in stiffness:
        reference = None
        for step in steps:
            run = drive(soil, step, k, seconds)
            reference = run if reference is None else reference
            rows.append(
                {
                    'stiffness': k,
                    'step_ms': 1e3 * step * soil.dt,
                    'stable': run['error'] is None
                    and run['longest'] <= STABLE * reference['longest'],
                    'longest_mm': 1e3 * run['longest'],
                    'force_difference': _difference(run, reference, max(step, 1.0) * soil.dt),
                    'error': run['error'],
                    'status': run['status'],
                }
            )
    return rows


def _difference(run, reference, spacing):
    """Relative L2 of the forces at the multiples of a time that both runs have."""
    ends = min(run['time'][-1:].sum(), reference['time'][-1:].sum())
    times = spacing * np.arange(1, int(ends / spacing + 1e-9) + 1)
    if not len(times):
        return None
    mine, theirs = (r['force'][np.searchsorted(r['time'], times - 1e-9)] for r in (run, reference))
    return float(np.linalg.norm(mine - theirs) / np.linalg.norm(theirs))


def table(path: str) -> str:
    """The figures of a JSON file of this command as a table of Markdown."""
    found = files.read_json(path)
    stiffness = sorted({row['stiffness'] for row in found[0]['rows']})
    lines = [
        '| model | step, ms | ' + ' | '.join(f'{k:.0e} N/m' for k in stiffness) + ' |',
        '|---|---|' + '---|' * len(stiffness),
    ]
    for model in found:
        for step in sorted({row['step_ms'] for row in model['rows']}):
            mine = {r['stiffness']: r for r in model['rows'] if r['step_ms'] == step}
            cells = ' | '.join(_cell(mine[k]) for k in stiffness)
            lines.append(f'| {model["model"]} | {step:.3g} | {cells} |')
    return '\n'.join(lines).replace('e+0', 'e')


def _cell(row):
    if row['stable']:
        return f'{100 * row["force_difference"]:.2g} %, {row["longest_mm"]:.1f} mm'
    return f'unstable ({row["error"] or format(row["longest_mm"], ".0f") + " mm"})'


def run(values) -> None:
    """Runs the command with its flags."""
    command.import_tensorflow(num_threads=1)
    found = []
    for path in values.models:
        scene = os.path.basename(os.path.dirname(os.path.normpath(path)))
        print(f'coupling {path} ...', flush=True)
        soil = open_soil(path, os.path.join(values.data_root, scene), values.run)
        found.append({'model': os.path.normpath(path), 'run': values.run, 'rows': measure(soil)})
        for row in found[-1]['rows']:
            print(row, flush=True)
        if values.output:
            files.write_json(values.output, found)


if __name__ == '__main__':
    flags.DEFINE_list(
        'models',
        ['models/excavation_v2/swept_field', 'models/excavation/pcg', 'models/wheel/pcg'],
        'Model folders.',
    )
    flags.DEFINE_string('data_root', 'datasets', 'Folder of the datasets, named as the scenes.')
    flags.DEFINE_integer('run', 1, 'Number of the test run whose path the carriage takes.', 0)
    flags.DEFINE_string('output', None, 'JSON file for the figures.')
    command.start(run)
