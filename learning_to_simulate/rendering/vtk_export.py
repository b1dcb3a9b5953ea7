"""Rollouts as VTK files for ParaView: one `.vtp` per frame, one `.pvd` with the times.

The `.vtp` are XML PolyData with inline binary arrays (base64, zlib), as "VTK XML Formats" (VTK
User's Guide) describes them; numpy and the standard library are enough to write them.
"""

from __future__ import annotations

import base64
import os
import zlib
from collections.abc import Iterable, Mapping
from xml.sax import saxutils

import numpy as np

from learning_to_simulate.rendering.rollout_frames import (
    PREDICTION,
    SOIL_PARTICLE_TYPE,
    TRUTH,
    RolloutFrames,
)
from pca_tools import files

_TYPES = {'f4': 'Float32', 'f8': 'Float64', 'i4': 'Int32', 'i8': 'Int64', 'u1': 'UInt8'}
_HEADER_TYPE = '<u4'
# Higher levels gain a few per cent on coordinates and take several times as long.
_COMPRESSION_LEVEL = 1
_VERSION = 'version="1.0" byte_order="LittleEndian"'


def write_rollout(folder: str, frames: RolloutFrames, drawn: Iterable[int]) -> None:
    """Writes a rollout as `<folder>/prediction.pvd`, its truth, if there is one, as `truth.pvd`.

    Each point (body first, then soil where there is a subspace) carries `displacement` since the
    first frame (m), `velocity` (m/s), `particle_type` and, of the prediction, `error` (m); each
    cloud carries `time` (s) and `force` (N).

    Args:
        folder: replaced as a whole, once everything is written.
        frames: the rollout.
        drawn: the frames to write.

    Raises:
        OSError: a file cannot be written.
    """

    def fill(temporary: str) -> None:
        listed = {which: [] for which in frames.shown}
        for which in listed:
            os.mkdir(os.path.join(temporary, which))
        for frame in drawn:
            for which, entries in listed.items():
                name = f'{which}/{frame:05d}.vtp'
                write_points(os.path.join(temporary, name), *_cloud(frames, which, int(frame)))
                entries.append((frames.time[frame], name))
        for which, entries in listed.items():
            write_collection(os.path.join(temporary, f'{which}.pvd'), entries)

    files.write_folder_atomically(folder, fill)


def _cloud(frames: RolloutFrames, which: str, frame: int):
    """Points, point data and field data of one frame."""
    rigid = frames.rigid[which]
    with_error = which == PREDICTION and frames.has_truth
    points = [rigid[frame]]
    vectors = {
        'displacement': [rigid[frame] - rigid[0]],
        'velocity': [frames.rigid_velocity(which, frame)],
    }
    if with_error:
        vectors['error'] = [rigid[frame] - frames.rigid[TRUTH][frame]]
    types = [frames.rigid_type] * len(rigid[frame])
    if frames.subspace is not None:
        points.append(frames.soil(which, frame))
        vectors['displacement'].append(frames.soil_displacement(which, frame))
        vectors['velocity'].append(frames.soil_velocity(which, frame))
        if with_error:
            vectors['error'].append(frames.soil_error(frame))
        types += [SOIL_PARTICLE_TYPE] * len(points[1])
    point_data = {name: np.concatenate(parts).astype(np.float32) for name, parts in vectors.items()}
    point_data['particle_type'] = np.array(types, np.int32)
    field_data = {'time': frames.time[frame : frame + 1]}
    if frames.force is not None:
        field_data['force'] = frames.force[which][frame]
    return np.concatenate(points).astype(np.float32), point_data, field_data


def write_points(
    path: str,
    points: np.ndarray,
    point_data: Mapping[str, np.ndarray],
    field_data: Mapping[str, np.ndarray],
) -> None:
    """Writes a point cloud as `.vtp`.

    Args:
        path: the file.
        points: [P, 3] m.
        point_data: name -> [P] or [P, k] values of the points.
        field_data: name -> [k] values of the whole cloud.

    Raises:
        ValueError: an array of the wrong length, or of a type that VTK does not have.
    """
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f'{path}: points have shape {points.shape}, [P, 3] was expected')
    for name, values in point_data.items():
        if len(values) != len(points):
            raise ValueError(
                f'{path}: point data {name!r} has {len(values)} values for {len(points)} points'
            )
    count = len(points)
    # Without a vertex cell on each point ParaView shows nothing.
    vertices = {
        'connectivity': np.arange(count, dtype=np.int32),
        'offsets': np.arange(1, count + 1, dtype=np.int32),
    }
    lines = [
        '<?xml version="1.0"?>',
        f'<VTKFile type="PolyData" {_VERSION} header_type="UInt32" '
        'compressor="vtkZLibDataCompressor">',
        '<PolyData>',
        '<FieldData>',
        *(
            _array(name, np.atleast_2d(values), ' NumberOfTuples="1"')
            for name, values in field_data.items()
        ),
        '</FieldData>',
        f'<Piece NumberOfPoints="{count}" NumberOfVerts="{count}" NumberOfLines="0" '
        'NumberOfStrips="0" NumberOfPolys="0">',
        '<PointData>',
        *(_array(name, values) for name, values in point_data.items()),
        '</PointData>',
        '<Points>',
        _array('Points', points),
        '</Points>',
        '<Verts>',
        *(_array(name, values) for name, values in vertices.items()),
        '</Verts>',
        '</Piece>',
        '</PolyData>',
        '</VTKFile>',
    ]
    _write(path, lines)


def write_collection(path: str, files_at_times: Iterable[tuple[float, str]]) -> None:
    """Writes a `.pvd`, which tells ParaView the time of each file.

    Args:
        path: the file.
        files_at_times: pairs (time in s, file name relative to the folder of `path`).
    """
    lines = [
        '<?xml version="1.0"?>',
        f'<VTKFile type="Collection" {_VERSION}>',
        '<Collection>',
        *(
            f'<DataSet timestep="{time:.9g}" part="0" file={saxutils.quoteattr(name)}/>'
            for time, name in files_at_times
        ),
        '</Collection>',
        '</VTKFile>',
    ]
    _write(path, lines)


def _array(name: str, values: np.ndarray, attributes: str = '') -> str:
    values = np.ascontiguousarray(values)
    kind = values.dtype.str[1:]
    if kind not in _TYPES:
        raise ValueError(f'array {name!r} has type {values.dtype}, VTK files hold {sorted(_TYPES)}')
    components = 1 if values.ndim == 1 else values.shape[1]
    return (
        f'<DataArray type="{_TYPES[kind]}" Name={saxutils.quoteattr(name)} '
        f'NumberOfComponents="{components}"{attributes} format="binary">'
        f'{_encoded(values.astype(values.dtype.newbyteorder("<")).tobytes())}</DataArray>'
    )


def _encoded(data: bytes) -> str:
    """Base64 of one compressed block, after the header that VTK gives to a row of blocks."""
    # Number of blocks, size of each, size of a shorter last one (0: none), compressed sizes.
    packed = zlib.compress(data, _COMPRESSION_LEVEL)
    header = np.array([1, len(data), 0, len(packed)], _HEADER_TYPE).tobytes()
    return (base64.b64encode(header) + base64.b64encode(packed)).decode('ascii')


def _write(path: str, lines: list[str]) -> None:
    with open(path, 'w', encoding='ascii') as file:
        file.write('\n'.join(lines) + '\n')
