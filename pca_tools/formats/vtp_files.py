"""Point clouds as `.vtp` for ParaView, `.pvd`, which gives them their times, and series of them.

XML PolyData with inline binary arrays (base64, zlib), as "VTK XML Formats" (VTK User's Guide)
describes them; numpy and the standard library are enough to write them. Reading takes files of any
program, so VTK itself does it. A series is a `.pvd` per run, or a folder of `.vtp` per run.
"""

import base64
import os
import re
import zlib
from collections.abc import Iterable, Mapping
from xml.etree import ElementTree
from xml.sax import saxutils

import numpy as np

from pca_tools import files
from pca_tools.formats import full_space
from pca_tools.formats.full_space import SOIL_TYPE, FullSpaceData, FullSpaceRun
from pca_tools.metadata import SPLITS

TITLE = 'a series of VTP files'
_TYPES = {'f4': 'Float32', 'f8': 'Float64', 'i4': 'Int32', 'i8': 'Int64', 'u1': 'UInt8'}
_HEADER_TYPE = '<u4'
# Higher levels gain a few per cent on coordinates and take several times as long.
_COMPRESSION_LEVEL = 1
_VERSION = 'version="1.0" byte_order="LittleEndian"'
_TYPE_NAMES = ('particle_type', 'type', 'tag')
# Times of a .pvd are printed with nine digits.
_EVEN_STEPS = 1e-4


def write_points(
    path: str,
    points: np.ndarray,
    point_data: Mapping[str, np.ndarray],
    field_data: Mapping[str, np.ndarray],
) -> None:
    """Writes points [P, 3] (m) as `.vtp`, with values [P] or [P, k] of the points and [k] of the
    whole cloud by name. ValueError: an array of the wrong length, or of a type that VTK lacks."""
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f'{path}: points have shape {points.shape}, [P, 3] was expected')
    for name, values in point_data.items():
        if len(values) != len(points):
            found = f'{len(values)} values for {len(points)} points'
            raise ValueError(f'{path}: point data {name!r} has {found}')
    count = len(points)
    # Without a vertex cell on each point ParaView shows nothing.
    connectivity = np.arange(count, dtype=np.int32)
    fields = (
        _array(name, np.atleast_2d(values), ' NumberOfTuples="1"')
        for name, values in field_data.items()
    )
    lines = [
        '<FieldData>', *fields, '</FieldData>',
        f'<Piece NumberOfPoints="{count}" NumberOfVerts="{count}" NumberOfLines="0" '
        'NumberOfStrips="0" NumberOfPolys="0">',
        '<PointData>', *(_array(name, held) for name, held in point_data.items()), '</PointData>',
        '<Points>', _array('Points', points), '</Points>',
        '<Verts>',
        _array('connectivity', connectivity), _array('offsets', connectivity + np.int32(1)),
        '</Verts>',
        '</Piece>',
    ]  # fmt: skip
    _write(path, 'PolyData', lines, ' header_type="UInt32" compressor="vtkZLibDataCompressor"')


def write_collection(path: str, files_at_times: Iterable[tuple[float, str]]) -> None:
    """Writes a `.pvd`, which tells ParaView the time (s) of each file, named relative to its
    folder."""
    lines = [
        f'<DataSet timestep="{time:.9g}" part="0" file={saxutils.quoteattr(name)}/>'
        for time, name in files_at_times
    ]
    _write(path, 'Collection', lines)


def _write(path: str, kind: str, lines: list[str], attributes: str = '') -> None:
    head = ['<?xml version="1.0"?>', f'<VTKFile type="{kind}" {_VERSION}{attributes}>']
    whole = [*head, f'<{kind}>', *lines, f'</{kind}>', '</VTKFile>', '']
    with open(path, 'w', encoding='ascii') as file:
        file.write('\n'.join(whole))


def _array(name: str, values: np.ndarray, attributes: str = '') -> str:
    values = np.ascontiguousarray(values)
    kind = values.dtype.str[1:]
    if kind not in _TYPES:
        raise ValueError(f'array {name!r} has type {values.dtype}, VTK files hold {sorted(_TYPES)}')
    components = 1 if values.ndim == 1 else values.shape[1]
    data = values.astype(values.dtype.newbyteorder('<')).tobytes()
    packed = zlib.compress(data, _COMPRESSION_LEVEL)
    # One compressed block: number of blocks, size of each, size of a shorter last one (0: none),
    # compressed sizes.
    header = np.array([1, len(data), 0, len(packed)], _HEADER_TYPE).tobytes()
    text = (base64.b64encode(header) + base64.b64encode(packed)).decode('ascii')
    return (
        f'<DataArray type="{_TYPES[kind]}" Name={saxutils.quoteattr(name)} '
        f'NumberOfComponents="{components}"{attributes} format="binary">{text}</DataArray>'
    )


def read_points(path: str) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Reads a `.vtp`: points [P, 3], point data and field data by name, as `write_points` takes
    them. ModuleNotFoundError: the package `vtk` is not installed. ValueError: damaged, or no
    points."""
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy

    files.refuse_git_lfs_pointer(path)
    vtk.vtkObject.GlobalWarningDisplayOff()  # damaged files are told of below, in one line
    reader = vtk.vtkXMLPolyDataReader()
    reader.SetFileName(os.path.abspath(path))
    reader.Update()
    data = reader.GetOutput()
    if reader.GetErrorCode() or not data.GetNumberOfPoints():
        raise ValueError(f'{path}: is not a readable .vtp with points')

    def arrays(attributes) -> dict[str, np.ndarray]:
        found = (attributes.GetArray(i) for i in range(attributes.GetNumberOfArrays()))
        return {array.GetName(): vtk_to_numpy(array).copy() for array in found if array}

    points = vtk_to_numpy(data.GetPoints().GetData()).copy()
    return points, arrays(data.GetPointData()), arrays(data.GetFieldData())


def read_collection(path: str) -> list[tuple[float, str]]:
    """Returns (time in s, path) of every file that a `.pvd` lists, by time; ValueError if it is no
    collection, lists nothing, or points out of its folder."""
    files.refuse_git_lfs_pointer(path)
    try:
        root = ElementTree.parse(path).getroot()
        found = [
            (float(item.attrib['timestep']), item.attrib['file']) for item in root.iter('DataSet')
        ]
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise ValueError(f'{path}: is not a .pvd collection: {error!r}') from error
    folder = os.path.dirname(os.path.abspath(path))
    for _, name in found:
        if os.path.isabs(name) or '..' in name.split('/'):
            raise ValueError(f'{path}: {name!r} points out of the folder')
    if not found:
        raise ValueError(f'{path}: lists no files')
    return [(time, os.path.join(folder, name)) for time, name in sorted(found)]


def series_of(folder: str) -> dict[str, list[tuple[float | None, str]]]:
    """Returns run -> (time or None, path) of its frames; empty where the folder holds no series."""
    names = sorted(os.listdir(folder))
    collections = [name for name in names if name.endswith('.pvd')]
    if collections:
        return {
            name.removesuffix('.pvd'): read_collection(os.path.join(folder, name))  # type: ignore[misc]
            for name in collections
        }
    if own := _frames(folder):
        return {os.path.basename(os.path.abspath(folder)): own}  # type: ignore[dict-item]
    series = {name: _frames(os.path.join(folder, name)) for name in names}
    return {name: frames for name, frames in series.items() if frames}  # type: ignore[misc]


def _frames(folder: str) -> list[tuple[None, str]]:
    """Returns the `.vtp` of a folder by the last number in their names."""
    names = os.listdir(folder) if os.path.isdir(folder) else []

    def number(name: str) -> tuple[int, str]:
        found = re.findall(r'\d+', name)
        return (int(found[-1]) if found else -1, name)

    ordered = sorted((name for name in names if name.endswith('.vtp')), key=number)
    return [(None, os.path.join(folder, name)) for name in ordered]


def read(folder: str, dt: float | None = None) -> FullSpaceData:
    """Opens a folder; `dt` is needed where no `.pvd` gives the times."""
    series = series_of(folder)
    dts = {name: _dt(name, [time for time, _ in frames]) for name, frames in series.items()}
    stated = sorted({dt for dt in dts.values() if dt is not None})
    if len(stated) > 1 and stated[-1] - stated[0] > _EVEN_STEPS * stated[-1]:
        raise ValueError(f'{folder}: runs have different times a frame: {dts}')
    return FullSpaceData(
        source=f'{folder} ({TITLE})',
        runs=lambda: (
            _run_of(name, [path for _, path in frames]) for name, frames in series.items()
        ),
        dt=dt or (stated[0] if stated else None),
    )


def _dt(name: str, times: list[float | None]) -> float | None:
    if len(times) < 2 or times[0] is None:
        return None
    steps = np.diff(np.array(times, np.float64))
    if np.ptp(steps) > _EVEN_STEPS * abs(steps.mean()) or steps.mean() <= 0:
        raise ValueError(f'{name}: its frames are not evenly spaced in time: {steps[:5]}')
    return float(steps.mean())


def _run_of(name: str, paths: list[str]) -> FullSpaceRun:
    frames = [read_points(path) for path in paths]
    counts = sorted({len(points) for points, _, _ in frames})
    if len(counts) != 1:
        raise ValueError(f'{paths[0]}: the frames of its run have {counts} points')
    data, fields = frames[0][1], [field for _, _, field in frames]
    types = next((data[key] for key in _TYPE_NAMES if key in data), np.int64(SOIL_TYPE))
    force = None
    if all('force' in field for field in fields):
        force = np.array([field['force'].ravel() for field in fields])
    split = next((split for split in SPLITS if name.startswith(split)), '')
    positions = np.stack([points for points, _, _ in frames])
    types = full_space.particle_types(types, positions, paths[0])
    return full_space.check_run(FullSpaceRun(name, split, positions, types, force), paths[0])


def write(folder: str, data: FullSpaceData) -> None:
    """Writes `<run>.pvd` and `<run>/00000.vtp` and on for every run."""
    for run in data.runs():
        os.mkdir(os.path.join(folder, run.name))
        types, listed = {'particle_type': run.particle_type.astype(np.int32)}, []
        for index, points in enumerate(full_space.in_space(run.positions)):
            time = index * (data.dt or 1.0)
            fields = {'time': np.array([time])}
            if run.force is not None:
                fields['force'] = run.force[index]
            listed.append((time, f'{run.name}/{index:05d}.vtp'))
            path = os.path.join(folder, listed[-1][1])
            write_points(path, np.asarray(points, np.float32), types, fields)
        write_collection(os.path.join(folder, f'{run.name}.pvd'), listed)
