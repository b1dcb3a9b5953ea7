"""Measures a swept field in C beside its networks in TensorFlow; a part of `benchmark`."""

import ctypes
import time

import numpy as np

from learning_to_simulate.export_c import c_library, c_values, field_data
from learning_to_simulate.export_c.c_field import CField
from learning_to_simulate.export_c.c_instance import KERNELS
from learning_to_simulate.methods.swept_field import model_files, tool_path
from learning_to_simulate.methods.swept_field.episodes import BedReader
from learning_to_simulate.methods.swept_field.tool_path import Bed
from pca_tools import dataset


def measure(library: ctypes.CDLL, model_path: str, data_path: str, calls: int, turns: int) -> dict:
    """CPU seconds of forces and of particles over the first recorded test run.

    Args:
      library: with the timing calls of native/bench_calls.c.
      model_path, data_path: a swept field and its dataset.
      calls: forces of each row in C; particles take a hundredth, TensorFlow a thousandth.
      turns: in which the rows take turns.

    Returns:
      by row, seconds [n].

    Raises:
      FileNotFoundError, ValueError: no model or dataset there, or a run without poses.
    """
    field = model_files.load(model_path)
    poses = dataset.read_split(data_path, 'test')[0].rigid_pose
    if poses is None:
        raise ValueError(f'{data_path}: the first test run holds no pose of its tool')
    poses = np.ascontiguousarray(poses, np.float64)
    data = c_values.Structure('lts_field_model', field_data.values(field))
    soils = {}
    for kernel in reversed(KERNELS):
        for members in dict.fromkeys((field.config.members, 1)):
            try:
                soil = CField(library, ctypes.addressof(data.value), kernel, members)
            except ValueError:  # a kernel that this machine lacks
                continue
            soil.start(poses[0])
            soils[f'{kernel}, {members} networks'.replace(' 1 networks', ' 1 network')] = soil
    times: dict[str, list] = {}
    for _ in range(turns):
        for name, soil in soils.items():
            alone = _c_times(library, soil, poses[1:], calls // turns, False, field.scene.dt)[0]
            times.setdefault(f'force, {name}', []).append(alone)
            count = max(calls // turns // 100, 1)
            placed = _c_times(library, soil, poses[1:], count, True, field.scene.dt)[1]
            times.setdefault(f'particles, {name}', []).append(placed)
        for name, values in _tensorflow(field, poses, max(calls // turns // 1000, 1)).items():
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
    some = poses[:: len(poses) // n][:n] if with_particles else poses[:n]
    some = np.ascontiguousarray(some)  # kept while its address is in use
    code = library.lts_time_field(
        soil.address, saved, len(saved), some.ctypes.data, n,
        dt * (len(poses) // n if with_particles else 1), runs,
        points.ctypes.data if with_particles else None, len(points),
        *(row.ctypes.data for row in seconds),
    )  # fmt: skip
    soil.load_state(saved)
    if code < 0:
        raise ValueError(f'the benchmark stopped: {c_library.load().lts_error_text(code).decode()}')
    return seconds


def _tensorflow(field, poses, count):
    """Seconds of single frames in numpy and TensorFlow."""
    plane, width = field.axes.poses(poses), np.array([field.blade.width])
    reader = BedReader(field.axes, field.grid, field.kept_spacing, field.spacing)
    surface, level, end = reader.read(field.rest, plane[0, 0], width[0])
    bed = Bed(surface[None], np.array([level]), np.array([end]))
    rest = (field.axes.points(field.rest) - [plane[0, 0], level, 0.0]).astype(np.float32)
    state = tool_path.start(field.grid, bed, plane[:1])
    field.warm_up()
    force, particles = [], []
    stride = max(1, (len(plane) - 1) // count)
    for pose in plane[1::stride][:count]:
        begin = time.process_time()
        state = tool_path.advance(field.grid, state, pose[None], stride * field.scene.dt)
        frame = tool_path.frame(field.grid, bed, width, state)
        field.loads(frame)
        middle = time.process_time()
        field.displacement(frame, rest)
        force.append(middle - begin)
        particles.append(time.process_time() - middle)
    return {
        'force, TensorFlow': np.array(force),
        'particles, TensorFlow': np.array(particles),
    }
