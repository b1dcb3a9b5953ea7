"""Rollouts as VTK files for ParaView: one `.vtp` per frame, one `.pvd` with the times.

The files themselves are written by `pca_tools.formats.vtp_files`.
"""

import os
from collections.abc import Iterable

import numpy as np

from learning_to_simulate.rendering.rollout_frames import PREDICTION, TRUTH, RolloutFrames
from pca_tools import dataset, files
from pca_tools.formats.vtp_files import write_collection, write_points


def write_rollout(folder: str, frames: RolloutFrames, drawn: Iterable[int]) -> None:
    """Writes a rollout as `<folder>/prediction.pvd`, its truth, if there is one, as `truth.pvd`,
    whole or not at all.

    Each point (body first, then soil where there is a subspace) carries `displacement` since the
    first frame (m), `velocity` since the last shown frame (m/s), `particle_type` and, of the
    prediction, `error` (m); each cloud carries `time` (s) and `force` (N).
    """

    def fill(temporary: str) -> None:
        listed = {which: [] for which in frames.shown}
        for which in listed:
            os.mkdir(os.path.join(temporary, which))
        for i in drawn:
            frame = int(frames.frames[i])
            for which, entries in listed.items():
                name = f'{which}/{frame:05d}.vtp'
                write_points(os.path.join(temporary, name), *_cloud(frames, which, int(i)))
                entries.append((frames.time[frame], name))
        for which, entries in listed.items():
            write_collection(os.path.join(temporary, f'{which}.pvd'), entries)

    files.write_folder_atomically(folder, fill)


def _cloud(frames: RolloutFrames, which: str, i: int):
    """Points, point data and field data of the i-th shown frame."""
    rigid, frame = frames.rigid[which], int(frames.frames[i])
    points = [rigid[frame]]
    vectors = {
        'displacement': [rigid[frame] - rigid[0]],
        'velocity': [(rigid[frame] - rigid[max(frame - 1, 0)]) / frames.dt],
    }
    if with_error := which == PREDICTION and frames.has_truth:
        vectors['error'] = [rigid[frame] - frames.rigid[TRUTH][frame]]
    types = [frames.rigid_type] * len(rigid[frame])
    if frames.soil:
        soil = frames.soil[which][i]
        points.append(soil)
        vectors['displacement'].append(soil - frames.start)
        vectors['velocity'].append(frames.soil_velocity(which, i))
        if with_error:
            vectors['error'].append(frames.soil_error(i))
        types += [dataset.MODE_PARTICLE_ID] * len(soil)
    point_data = {name: np.concatenate(parts).astype(np.float32) for name, parts in vectors.items()}
    point_data['particle_type'] = np.array(types, np.int32)
    field_data = {'time': frames.time[frame : frame + 1]}
    if frames.force is not None:
        field_data['force'] = frames.force[which][frame]
    return np.concatenate(points).astype(np.float32), point_data, field_data
