"""Measures the C step beside TensorFlow's stepper, in one run, as CPU time of one core.

Every figure is also given as a ratio to the first row, because machines are busy: compare ratios
within one run.

Example:
  python -m learning_to_simulate.export_c.benchmark --output=build/c_times.json \\
      --models=models/excavation/pcg,models/wheel/pcg
"""

import ctypes
import os
import sys
import time

import numpy as np
from absl import app, flags

from learning_to_simulate import checkpoints, registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.export_c import (
    benchmark_field,
    c_header,
    c_library,
    c_stepper,
    starts,
)
from learning_to_simulate.export_c.c_soil import CSoil
from learning_to_simulate.live import stepping
from pca_tools import files
from pca_tools.storage import markdown

PLAIN_FLAGS = ('-std=c99', '-O2', '-fPIC', '-shared')
TURNS = 5  # the rows of the table take turns, so that a busy moment hits all of them


def measure(model_path: str, data_path: str, calls: int) -> dict[str, dict]:
    """CPU times of the calls that answer a pose, over a recorded test run.

    Args:
      model_path: trained model.
      data_path: its dataset.
      calls: of each C call; the Python rows take a tenth, TensorFlow a hundredth.

    Returns:
      by row, `median_us` and `p99_us`.

    Raises:
      FileNotFoundError, ValueError: no model or dataset there, or no test run of its size.
      c_library.NoCompiler: there is no C compiler.
    """
    library = timed_library()
    timed = library.lts_time_calls
    if checkpoints.read_config(model_path)['config'].get('model') == 'swept_field':
        rows = benchmark_field.measure(library, model_path, data_path, calls, TURNS)
        return {name: _row(seconds) for name, seconds in rows.items()}
    model, n, subspace, found = starts.read_model(model_path, data_path)
    opened = registry.open_model(model_path, data_path, 'test')
    groups = opened.groups
    group = next((g for g in groups if g.n_rigid == n), None)
    if group is None:
        raise ValueError(f'{data_path}: no test run has {n} rigid nodes')
    known = model.simulator.scene.rigid_motion.is_known
    history = group.position[0, :H]
    context = group.context_at(H, 0)
    poses = np.ascontiguousarray(group.position[0, H:, :n])
    data = c_stepper.CStepper(model, n, subspace, starts=found)
    fast = {'C step': CSoil(library, data.model, 'best')}
    if fast['C step'].kernel == 'avx512':
        fast['C step, AVX2'] = CSoil(library, data.model, 'avx2')
    fast['plain build (-O2, 4-wide)'] = CSoil(library, data.model, 'vector4')
    python = {
        'from Python, with particles': data,
        "TensorFlow's stepper, with particles": stepping.Stepper(model, n, subspace),
    }
    for soil in (*fast.values(), *python.values()):
        soil.reset(history, context)
    times: dict[str, list] = {}
    for _ in range(TURNS):
        for name, soil in fast.items():
            parts = _c_times(timed, soil, poses if known else None, len(poses), calls // TURNS)
            times.setdefault(name, []).append(parts[0] + parts[1])
            if name == 'C step':
                for part, values in zip(('prepare', 'pose -> force', 'decode'), parts):
                    times.setdefault(part, []).append(values)
        for share, (name, stepper) in zip((10, 100), python.items()):
            count = max(calls // TURNS // share, 1)
            times.setdefault(name, []).append(
                _python_times(stepper, history, context, poses, known, count)
            )
    return {name: _row(np.concatenate(values)) for name, values in times.items()}


def _row(seconds):
    return {
        'median_us': 1e6 * float(np.median(seconds)),
        'p99_us': 1e6 * float(np.percentile(seconds, 99)),
        'calls': len(seconds),
    }


def timed_library() -> ctypes.CDLL:
    """The library with the loops of native/bench_calls.c, compiled plainly.

    Raises:
      OSError, c_library.NoCompiler, c_library.CompileFailed: as `c_library.load_once`.
    """
    extra = [os.path.join(c_header.NATIVE, 'bench_calls.c')]
    library = c_library.load_once(PLAIN_FLAGS, extra)
    pointer, size, number = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
    count, real = ctypes.c_int64, ctypes.c_double
    library.lts_time_calls.argtypes = (
        pointer, pointer, size, pointer, number, number, number, pointer, size, *3 * (pointer,),
    )  # fmt: skip
    library.lts_time_field.argtypes = (
        pointer, pointer, size, pointer, number, real, number, pointer, size, pointer, pointer,
    )  # fmt: skip
    library.lts_run_on.argtypes = (
        pointer, pointer, size, pointer, number, number, count, count, pointer, number,
        *3 * (pointer,),
    )  # fmt: skip
    library.lts_run_field_on.argtypes = (
        pointer, pointer, size, pointer, number, real, count, count, *3 * (pointer,),
    )  # fmt: skip
    return library


def _c_times(timed, soil, poses, n_frame, calls):
    """Seconds [3, calls] of prepare, frame and decode over whole runs."""
    runs = max(calls // n_frame, 1)
    saved, seconds = soil.save(), np.empty((3, runs * n_frame))
    particles = np.empty((max(soil.n_soil, 1), 3), np.float32)
    code = timed(
        soil.address, saved, len(saved), None if poses is None else poses.ctypes.data,
        0 if poses is None else poses[0].size, n_frame, runs,
        particles.ctypes.data if soil.n_soil else None, soil.n_soil,
        *(row.ctypes.data for row in seconds),
    )  # fmt: skip
    if code < 0:
        raise ValueError(f'the benchmark stopped with error {code} of lts.h')
    return seconds


def _python_times(stepper, history, context, poses, known, count):
    """Seconds [count] of a step and its particles."""
    seconds = []
    while len(seconds) < count:
        stepper.reset(history, context)
        for pose in poses[: count - len(seconds)]:
            start = time.process_time()
            stepper.step(pose if known else None)
            stepper.particles()
            seconds.append(time.process_time() - start)
    return np.array(seconds)


def table(results: dict[str, dict[str, dict]]) -> str:
    """The figures of all models as tables of Markdown."""
    tables = []
    for model, rows in results.items():
        reference, first = next(iter(rows.items()))
        header = (f'{model}: CPU time of one core, us', 'median', 'p99', 'p99/median',
                  f'of `{reference}`')  # fmt: skip
        lines = []
        for name, row in rows.items():
            median, p99 = row['median_us'], row['p99_us']
            ratios = p99 / median, median / first['median_us']
            lines.append((name, f'{median:.1f}', f'{p99:.1f}', *(f'{x:.2f}' for x in ratios)))
        tables.append(markdown.table(header, lines) + '\n')
    return '\n'.join(tables)


def table_of(path: str, number: str) -> str:
    """The figures of one model of a JSON of this command, the first is '1'; for the documents."""
    model, rows = list(files.read_json(path).items())[int(number) - 1]
    return table({model: rows}).rstrip()


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_list('models', ['models/excavation/pcg', 'models/wheel/pcg'], 'Model folders.')
    flags.DEFINE_list('data', None, 'Their datasets; default: datasets/<scene of the path>.')
    flags.DEFINE_integer('calls', 100_000, 'Calls of each row in C.', 1)
    flags.DEFINE_string('output', None, 'JSON file for the figures.')


def main(_) -> None:
    """Runs the command."""
    v = flags.FLAGS
    data = v.data or [
        os.path.join('datasets', os.path.basename(os.path.dirname(os.path.normpath(path))))
        for path in v.models
    ]
    if len(data) != len(v.models):
        sys.exit(f'error: {len(v.models)} models but {len(data)} datasets')
    results = {}
    try:
        for path, folder in zip(v.models, data):
            print(f'measuring {path} ...', flush=True)
            results[path] = measure(path, folder, v.calls)
    except (ValueError, OSError, c_library.NoCompiler) as error:
        sys.exit(f'error: {files.printable(error)}')
    print(table(results))
    if v.output:
        files.write_json(v.output, results)


if __name__ == '__main__':
    define_flags()
    app.run(main)
