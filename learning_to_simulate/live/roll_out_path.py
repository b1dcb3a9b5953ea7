"""Rolls out a path of one's own: poses in, positions, forces and status out.

Examples:
  # a soil field, on a terrain that `lts.Terrain.save` wrote
  lts rollout --model=excavation --terrain=ground.npz --tool=width=0.4 --poses=path.csv \
      --output_path=dig.npz --picture=dig.png

  # a model in the subspace, on a recorded bed
  lts rollout --model=excavation/pcg --poses=path.csv --output_path=dig.npz --picture=dig.gif

The file of poses has a line a frame (1/60 s for the shipped models): x, y, z, qw, qx, qy, qz, or
x, height, angle (rad) of a body in the plane; `.csv` (lines that begin with # are skipped) or
`.npy`. What is written is read by `render_rollout`.
"""

import dataclasses
import os
import warnings

import numpy as np
from absl import flags

from learning_to_simulate import command
from pca_tools import files


def read_poses(path: str) -> np.ndarray:
    """float64 [T, 7] or [T, 3] of a file; FileNotFoundError, or ValueError for what is no table of
    numbers."""
    if not os.path.isfile(path):
        raise FileNotFoundError(f'{path}: no such file')
    if path.endswith('.npy'):
        return files.read_npy(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('error', UserWarning)  # numpy's of a file without data
            return np.loadtxt(path, delimiter=',', ndmin=2)
    except (ValueError, UserWarning) as error:
        raise ValueError(
            f'{path}: is not a table of numbers without a header, a line a frame: '
            f'x,y,z,qw,qx,qy,qz or x,height,angle in rad ({error})'
        ) from error


def _ground(values, model):
    """Terrain and tool of the flags, of a soil field."""
    from learning_to_simulate.soil_field.terrain import Terrain

    if values.case is not None or not values.terrain:
        raise ValueError(f'{values.model} is a soil field: it takes --terrain and no --case')
    kind = model.model.networks.tool
    fields = {f.name: f.type for f in dataclasses.fields(kind)}
    return Terrain.load(values.terrain), kind(**command.settings(values.tool, fields, 'tool'))


def run(values) -> None:
    path = read_poses(values.poses)
    if values.picture:
        from learning_to_simulate import render_rollout

        render_rollout.target_and_format(values.picture)  # before the work
    targets = filter(None, (values.output_path, values.picture))
    folders = [os.path.dirname(os.path.abspath(target)) for target in targets]
    for folder in folders:
        command.writable_folder(folder)
    command.import_tensorflow()
    from learning_to_simulate import api

    model = api.load(values.model)
    if isinstance(model, api.TerrainModel):
        rollout = model.rollout(path, *_ground(values, model))
    elif values.terrain or values.tool:
        raise ValueError(f'{values.model}: --terrain and --tool are for soil fields')
    else:
        rollout = model.rollout(path, case=values.case)
    for folder in folders:
        os.makedirs(folder, exist_ok=True)
    rollout.save(values.output_path)
    dt = rollout.time[1] - rollout.time[0] if len(rollout) > 1 else 0.0
    print(f'wrote {values.output_path}: {len(rollout)} frames of {dt:.4g} s')
    print(f'status {rollout.status}' + (f': {rollout.reason}' if rollout.reason else ''))
    if rollout.force is not None:
        size = np.linalg.norm(rollout.force, axis=1)
        print(f'force: mean {size.mean():.4g} N, largest {size.max():.4g} N')
    if values.picture:
        rollout.render(values.picture)
        print(f'wrote {values.picture}')


if __name__ == '__main__':
    flags.DEFINE_string('model', None, 'Model folder, or a shipped model by name.', required=True)
    flags.DEFINE_string('poses', None, 'File of poses, one a frame.', required=True)
    flags.DEFINE_string('output_path', None, 'Rollout file to write (.npz).', required=True)
    flags.DEFINE_string('picture', None, 'Picture to draw as well: .png, .gif or .mp4.')
    flags.DEFINE_string('terrain', None, 'Of a soil field: file of `lts.Terrain.save`.')
    flags.DEFINE_multi_string(
        'tool', [], 'Of a soil field: NAME=VALUE of its tool, as width=0.4; may be given again.'
    )
    flags.DEFINE_string('case', None, 'Case whose bed and body are taken; default: the first.')
    command.start(run)
