"""Measures a swept field in C beside its stepper in Python; a part of `benchmark`."""

import ctypes
import time

import numpy as np

from learning_to_simulate.export_c import c_library, c_values, field_data
from learning_to_simulate.export_c.c_field import CField
from learning_to_simulate.export_c.c_instance import KERNELS, KernelLacks
from learning_to_simulate.live import resting_start
from learning_to_simulate.swept_field.live import LiveField
from pca_tools import dataset


def measure(library: ctypes.CDLL, model_path: str, data_path: str, calls: int, turns: int) -> dict:
    """CPU seconds of forces and of particles over the first recorded test run.

    Args:
      library: with the timing calls of native/bench_calls.c.
      model_path, data_path: a swept field and its dataset.
      calls: forces of each row in C; particles take a hundredth, Python a thousandth.
      turns: in which the rows take turns.

    Returns:
      by row, seconds [n].

    Raises:
      FileNotFoundError, ValueError: no model or dataset there, or a run without poses.
    """
    field, parts = field_data.read(model_path)
    run = dataset.read_split(data_path, 'test')[0]
    if run.rigid_pose is None:
        raise ValueError(f'{data_path}: the first test run holds no pose of its tool')
    poses = np.ascontiguousarray(run.rigid_pose, np.float64)
    live = LiveField(field, *resting_start.read(model_path))
    data = c_values.Structure('lts_field_model', field_data.values(field, **parts))
    start = _begun(live, data_path, run, poses[0])
    soils = {}
    for kernel in reversed(KERNELS):
        for members in dict.fromkeys((field.config.members, 1)):
            try:
                soil = CField(library, ctypes.addressof(data.value), kernel, members)
            except KernelLacks:
                continue
            soil.start(poses[0], **start)
            soils[f'{kernel}, {members} networks'.replace(' 1 networks', ' 1 network')] = soil
    times: dict[str, list] = {}
    for _ in range(turns):
        for name, soil in soils.items():
            alone = _c_times(library, soil, poses[1:], calls // turns, False, field.scene.dt)[0]
            times.setdefault(f'force, {name}', []).append(alone)
            count = max(calls // turns // 100, 1)
            placed = _c_times(library, soil, poses[1:], count, True, field.scene.dt)[1]
            times.setdefault(f'particles, {name}', []).append(placed)
        for name, values in _python(live, poses, max(calls // turns // 1000, 1)).items():
            times.setdefault(name, []).append(values)
    rows = {name: np.concatenate(parts) for name, parts in times.items()}
    return dict(sorted(rows.items(), key=lambda row: not row[0].startswith('force')))


def _c_times(library, soil, poses, count, with_particles, dt):
    """Seconds [2, count or more] of forces and particles of whole runs, or of a part of one."""
    n = min(count, len(poses))
    runs = max(count // n, 1)
    saved, seconds = soil.save(), np.empty((2, runs * n))
    points = np.empty((soil.description.n_soil, 3), np.float32)
    # Fewer particles than frames are of frames spread over the run.
    stride = len(poses) // n if with_particles else 1
    some = np.ascontiguousarray(poses[::stride][:n])
    code = library.lts_time_field(
        soil.address, saved, len(saved), some.ctypes.data, n, dt * stride, runs,
        points.ctypes.data if with_particles else None, len(points),
        *(row.ctypes.data for row in seconds),
    )  # fmt: skip
    soil.load_state(saved)
    if code < 0:
        raise ValueError(f'the benchmark stopped: {c_library.load().lts_error_text(code).decode()}')
    return seconds


def _begun(live, data_path, run, pose):
    """Begins a run in Python; says how C begins it: the usual blade, or the wheel of that case."""
    if run.step_context is None:
        live.start(pose)
        return {}
    case = dataset.read_metadata(data_path).get('cases', {}).get('test', [{}])[0].get('case')
    context = run.step_context[0].astype(np.float64)
    live.start(pose, case=case if case in live.cases else None, context=context)
    return {'index': live.start_index, 'context': context}


def _python(live, poses, count):
    """Seconds of single frames in numpy and TensorFlow."""
    force, particles = [], []
    stride, begun = max(1, (len(poses) - 1) // count), live.state
    for pose in poses[1::stride][:count]:
        begin = time.process_time()
        live.step(pose, dt=stride * live.dt)
        middle = time.process_time()
        live.particles()
        force.append(middle - begin)
        particles.append(time.process_time() - middle)
    live.state = begun
    return {'force, Python': np.array(force), 'particles, Python': np.array(particles)}
