"""Runs a model in C for millions of frames: what grows, what is not finite, what the memory does.

A recorded test run is played in two ways. `again`: it begins anew where it ends, as a trainer or a
planner uses the model. `without end`: forth and back on the same soil, never started again, which
no model that adds up displacements was trained for; its status says so from the first frame on
that leaves the training.

Example:
  nice -n 19 python -m learning_to_simulate.export_c.endurance --frames=10_000_000 \\
      --models=models/excavation/pcg --output=build/endurance.json
"""

import ctypes
import os
import resource
import time

import numpy as np
from absl import flags

from learning_to_simulate import checkpoints, command, registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.export_c import benchmark, c_header, c_stepper, field_data, starts
from learning_to_simulate.export_c.c_field import CField
from learning_to_simulate.export_c.c_values import Structure
from learning_to_simulate.swept_field import field as field_lib
from pca_tools import dataset, files

WAYS = ('again', 'without end')
# Frames until the first figures; then those of every tenfold, from a million on of every million.
FIRST, MILLION = 1000, 1_000_000


def measure(model_path: str, data_path: str, frames: int, way: str, keep=lambda row: None) -> dict:
    """Plays the first recorded test run for some frames.

    Args:
      model_path, data_path: a graph network, MLP or swept field, and its dataset.
      frames: in all.
      way: one of `WAYS`.
      keep: called with what is returned, as far as it is, whenever there are new figures.

    Returns:
      `frames`; `cpu_us` of one; `not_finite`: how many numbers were not; `state_bytes` and
      `memory_kb` (largest of the process), at the beginning and at the end; `largest`: rows of the
      frames played so far, the largest mode (m; of a swept field the torque, N m) and force (N)
      since the row before; `status`: bits of all frames.

    Raises:
      FileNotFoundError, ValueError: no model or dataset there, or a call that failed.
      c_library.NoCompiler: there is no C compiler.
    """
    library = benchmark.timed_library()
    if checkpoints.read_config(model_path)['config'].get('model') == 'swept_field':
        soil, play = _field(library, model_path, data_path, way)
    else:
        soil, play = _graph(library, model_path, data_path, way)
    sizes, memory, cpu = [len(soil.save())], [_memory()], time.process_time()
    not_finite, status = ctypes.c_int64(), ctypes.c_int32()
    rows: list[dict] = []
    found: dict = {}
    done, ends = 0, FIRST
    while done < frames:
        largest = np.zeros(2)
        n = min(ends, frames) - done
        code = play(done, n, largest.ctypes.data, *map(ctypes.byref, (not_finite, status)))
        if code < 0:
            raise ValueError(f'{model_path}: {library.lts_error_text(code).decode()}')
        done, ends = done + n, min(10 * ends, ends + MILLION)
        mode, force = map(float, largest)
        rows.append({'frames': done, 'mode_or_torque': mode, 'force': force})
        found = {
            'frames': done,
            'cpu_us': 1e6 * (time.process_time() - cpu) / done,
            'not_finite': not_finite.value,
            'status': status.value,
            'state_bytes': [*sizes, len(soil.save())],
            'memory_kb': [*memory, _memory()],
            'largest': list(rows),
        }
        keep(found)
    return found


def _memory():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _to_and_fro(path, way):
    """The path, and back to its second frame where it is played without end."""
    whole = path if way == 'again' else np.concatenate([path, path[-2:0:-1]])
    return np.ascontiguousarray(whole, np.float64)


def _graph(library, model_path, data_path, way):
    """A run after the given frames, and how it is played on."""
    model, n, subspace, found = starts.read_model(model_path, data_path)
    groups = registry.open_model(model_path, data_path, 'test').groups
    group = next((g for g in groups if g.n_rigid == n), None)
    if group is None:
        raise ValueError(f'{data_path}: no test run has {n} rigid nodes')
    data = c_stepper.CStepper(model, n, subspace, starts=found)
    soil = c_stepper.CSoil(library, data.model)
    soil.reset(group.position[0, :H], group.context_at(H, 0))
    known = model.simulator.scene.rigid_motion.is_known
    points = _to_and_fro(group.position[0, H:, :n], way)
    modes = np.empty((group.position.shape[2] - n, 3))
    saved = soil.save() if way == 'again' else None

    def play(at, count, *results):
        # `data` holds the weights that the library reads.
        assert data.model
        return library.lts_run_on(
            soil.address, saved, len(saved or b''), points.ctypes.data if known else None,
            points[0].size, len(points), at, count, modes.ctypes.data, modes.size, *results,
        )  # fmt: skip

    return soil, play


def _field(library, model_path, data_path, way):
    field = field_lib.load(model_path)
    poses = dataset.read_split(data_path, 'test')[0].rigid_pose
    if poses is None:
        raise ValueError(f'{data_path}: the first test run holds no pose of its tool')
    data = Structure('lts_field_model', field_data.values(field))
    soil = CField(library, ctypes.addressof(data.value))
    soil.start(poses[0])
    path = _to_and_fro(poses[1:], way)
    saved = soil.save() if way == 'again' else None

    def play(at, count, *results):
        assert data.value
        return library.lts_run_field_on(
            soil.address, saved, len(saved or b''), path.ctypes.data, len(path), field.scene.dt,
            at, count, *results,
        )  # fmt: skip

    return soil, play


def table(path: str) -> str:
    """The figures of a JSON file of this command as a table of Markdown."""
    bits = {v: k for k, v in c_header.constants().items() if k in _BITS}
    lines = [
        '| model | played | frames | not finite | state, bytes | memory, kB '
        '| largest mode (torque) by frame | status |',
        '|---|---|---|---|---|---|---|---|',
    ]
    for row in files.read_json(path):
        growth = ', '.join(
            f'{r["frames"]:.2g}: {r["mode_or_torque"]:.3g}'
            for i, r in enumerate(row['largest'], 1)
            if i == len(row['largest']) or r['frames'] in _POWERS
        )
        told = [_BITS[name] for bit, name in bits.items() if row['status'] & bit]
        lines.append(
            f'| {row["model"]} | {row["way"]} | {row["frames"]:.2g} | {row["not_finite"]} | '
            f'{_same(row["state_bytes"])} | {_same(row["memory_kb"])} | '
            f'{growth} | {", ".join(told) or "ok"} |'
        )
    return '\n'.join(lines).replace('e+0', 'e')


_POWERS = {10**n for n in range(3, 10)}
_BITS = {
    'LTS_OUTSIDE_CONTEXT': 'context', 'LTS_OUTSIDE_START': 'start', 'LTS_OUTSIDE_POSE': 'pose',
    'LTS_OUTSIDE_SPEED': 'speed', 'LTS_LEFT_BOUNDS': 'left bounds',
    'LTS_NON_FINITE': 'not finite',
}  # fmt: skip


def _same(values):
    first, last = values
    return str(first) if first == last else f'{first} -> {last}'


def run(values) -> None:
    """Runs the command with its flags."""
    command.import_tensorflow(num_threads=1)
    scenes = [os.path.basename(os.path.dirname(os.path.normpath(path))) for path in values.models]
    data = values.data or [os.path.join('datasets', scene) for scene in scenes]
    if len(data) != len(values.models):
        raise ValueError(f'{len(values.models)} models but {len(data)} datasets')
    rows = []
    for path, folder in zip(values.models, data):
        for way in values.ways:
            print(f'playing {path} {way} ...', flush=True)
            rows.append({'model': os.path.normpath(path), 'way': way})

            def keep(row, mine=rows[-1]):  # a long command keeps what it has
                mine.update(row)
                if values.output:
                    files.write_json(values.output, rows)

            measure(path, folder, values.frames, way, keep)
            print(rows[-1], flush=True)


if __name__ == '__main__':
    flags.DEFINE_list('models', ['models/excavation/pcg', 'models/wheel/pcg'], 'Model folders.')
    flags.DEFINE_list('data', None, 'Their datasets; default: datasets/<scene of the path>.')
    flags.DEFINE_multi_enum('ways', list(WAYS), WAYS, 'How the recorded run is played.')
    flags.DEFINE_integer('frames', 10_000_000, 'Frames of each.', 1)
    flags.DEFINE_string('output', None, 'JSON file for the figures.')
    command.start(run)
