"""Rolls out a path of one's own: poses in, positions, forces and status out.

Examples:
  lts rollout --model=excavation --poses=path.csv --output_path=dig.npz --picture=dig.gif

The file of poses has a line a frame (1/60 s for the shipped models): x, y, z, qw, qx, qy, qz, or
x, height, angle (rad) of a body in the plane; `.csv` (lines that begin with # are skipped) or
`.npy`. What is written is read by `render_rollout`.
"""

import os

import numpy as np
from absl import flags

from learning_to_simulate import command
from pca_tools import files


def read_poses(path: str) -> np.ndarray:
    """float64 [T, 7] or [T, 3] of a file.

    Raises:
      FileNotFoundError: there is none.
      ValueError: not a table of numbers.
    """
    if not os.path.isfile(path):
        raise FileNotFoundError(f'{path}: no such file')
    if path.endswith('.npy'):
        return files.read_npy(path)
    try:
        return np.loadtxt(path, delimiter=',', ndmin=2)
    except ValueError as error:
        raise ValueError(f'{path}: is not a table of numbers, x,y,z,qw,... ({error})') from error


def run(values) -> None:
    """Runs the command with its flags."""
    path = read_poses(values.poses)
    if values.picture:
        from learning_to_simulate import render_rollout

        render_rollout.target_and_format(values.picture)  # before the work
    for target in filter(None, (values.output_path, values.picture)):
        command.writable_folder(os.path.dirname(os.path.abspath(target)))
    command.import_tensorflow()
    from learning_to_simulate import api

    rollout = api.load(values.model).rollout(path, case=values.case)
    for target in filter(None, (values.output_path, values.picture)):
        os.makedirs(os.path.dirname(os.path.abspath(target)), exist_ok=True)
    rollout.save(values.output_path)
    print(f'wrote {values.output_path}: {len(rollout)} frames of {rollout.scene.dt:.4g} s')
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
    flags.DEFINE_integer('case', None, 'Case whose bed and body are taken; default: the first.')
    command.start(run)
