"""What particles of a swept field cost in C, and what fewer or narrower networks lose on valid.

Errors are those of `metrics.json` of each model, over the valid runs that all models have; times
are CPU times with AVX2 over the first test run, all in one process.

Example:
  python -m learning_to_simulate.export_c.particle_cost --output=build/particle_cost.json \\
      --models=models/excavation_v2/swept_field,build/narrow --data_path=datasets/excavation_v2
"""

import os
import time

import numpy as np
from absl import flags

from learning_to_simulate import command
from learning_to_simulate.export_c.c_field import CField
from learning_to_simulate.swept_field import field as field_lib
from pca_tools import dataset, files
from pca_tools.storage import markdown

FRAMES, TURNS = 32, 8


def measure(model_paths, data_path: str) -> list[dict]:
    """A row for each model with all of its members, and with one of them for the particles.

    Args:
      model_paths: swept fields of blades.
      data_path: their dataset.

    Returns:
      dicts of `name`, `members`, `products` (multiplications of one particle in one network),
      `moving` particles on average, `mflop` of a frame, `median_us`, `calm_us` (the fastest tenth:
      a busy neighbour slows a core even in its own time), `soil_mm` on valid.

    Raises:
      FileNotFoundError, ValueError: no model or dataset there; a run without poses.
      c_library.NoCompiler: there is no C compiler.
    """
    poses = dataset.read_split(data_path, 'test')[0].rigid_pose
    if poses is None:
        raise ValueError(f'{data_path}: the first test run holds no pose of its tool')
    stride = max(1, (len(poses) - 1) // FRAMES)
    poses = np.asarray(poses, np.float64)[::stride]
    judged = {path: _valid(path) for path in model_paths}
    shared = set.intersection(*(set(runs) for runs in judged.values()))
    rows, soils = [], []
    for path in model_paths:
        field = field_lib.load(path)
        products = sum(int(np.prod(w.shape[1:])) for w, _ in field.network.soil.layers)
        for members in dict.fromkeys((field.config.members, 1)):
            key = 'soil_mm' if members > 1 else 'soil_mm_of_members'
            soils.append((CField.of(field, 'avx2', particle_members=members), field.scene.dt))
            rows.append(
                {
                    'name': os.path.normpath(path),
                    'members': members,
                    'width': field.config.latent_size,
                    'products': products,
                    'runs': len(shared),
                    'soil_mm': float(np.mean([judged[path][run][key] for run in sorted(shared)])),
                }
            )
    seconds: list[list[float]] = [[] for _ in rows]
    for _ in range(TURNS):
        for (soil, dt), kept in zip(soils, seconds):
            kept += _times(soil, poses, stride * dt)
    for row, (soil, dt), kept in zip(rows, soils, seconds):
        row['moving'] = _moving(soil, poses, stride * dt)
        row['mflop'] = 2e-6 * row['moving'] * row['products'] * row['members']
        row['median_us'] = 1e6 * float(np.median(kept))
        row['calm_us'] = 1e6 * float(np.quantile(kept, 0.1))
    return rows


def _valid(path):
    """Valid runs of a model's metrics by the motion of their soil, which tells them apart."""
    rows = files.read_json(os.path.join(path, 'metrics.json'))['field']
    return {round(row['still_mm'], 6): row for row in rows}


def _times(soil, poses, dt):
    soil.start(poses[0])
    found = []
    for pose in poses[1:]:
        soil.step(pose, dt)
        begin = time.process_time()
        soil.particles()
        found.append(time.process_time() - begin)
    return found


def _moving(soil, poses, dt):
    soil.start(poses[0])
    counts = []
    for pose in poses[1:]:
        soil.step(pose, dt)
        counts.append(soil.moving())
    return float(np.mean(counts))


def table(path: str) -> str:
    """The rows of a JSON file of this command."""
    header = ('networks of the particles', 'soil on valid, mm', 'products of a particle',
              'MFLOP a frame', 'us, median', 'us, fastest tenth', 'GFLOP/s of that')  # fmt: skip
    lines = []
    for row in files.read_json(path):
        lines.append(
            (
                f'{row["members"]} x {row["width"]} wide',
                f'{row["soil_mm"]:.2f}',
                row['members'] * row['products'],
                f'{row["mflop"]:.3g}',
                f'{row["median_us"]:.0f}',
                f'{row["calm_us"]:.0f}',
                f'{1e3 * row["mflop"] / row["calm_us"]:.0f}',
            )
        )
    return markdown.table(header, lines)


def run(values) -> None:
    """Runs the command with its flags."""
    command.import_tensorflow(num_threads=1)
    rows = measure(values.models, values.data_path)
    print(*rows, sep='\n')
    if values.output:
        files.write_json(values.output, rows)


if __name__ == '__main__':
    flags.DEFINE_list('models', ['models/excavation_v2/swept_field'], 'Model folders.')
    flags.DEFINE_string('data_path', 'datasets/excavation_v2', 'Their dataset.')
    flags.DEFINE_string('output', None, 'JSON file for the figures.')
    command.start(run)
