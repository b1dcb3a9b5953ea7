"""Point clouds as `.vtp` for ParaView, and `.pvd`, which gives them their times.

XML PolyData with inline binary arrays (base64, zlib), as "VTK XML Formats" (VTK User's Guide)
describes them; numpy and the standard library are enough to write them. Reading takes files of any
program, so VTK itself does it.
"""

from __future__ import annotations

import base64
import os
import zlib
from collections.abc import Iterable, Mapping
from xml.etree import ElementTree
from xml.sax import saxutils

import numpy as np

from pca_tools import files

_TYPES = {'f4': 'Float32', 'f8': 'Float64', 'i4': 'Int32', 'i8': 'Int64', 'u1': 'UInt8'}
_HEADER_TYPE = '<u4'
# Higher levels gain a few per cent on coordinates and take several times as long.
_COMPRESSION_LEVEL = 1
_VERSION = 'version="1.0" byte_order="LittleEndian"'


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


def read_points(path: str) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Reads a `.vtp`; the counterpart of `write_points`.

    Returns:
        points [P, 3], point data and field data by name.

    Raises:
        ModuleNotFoundError: the package `vtk` is not installed.
        ValueError: damaged file, or one without points.
    """
    try:
        import vtk
        from vtk.util.numpy_support import vtk_to_numpy
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f'{path}: reading .vtp takes the package vtk: pip install vtk'
        ) from error
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
    """Returns (time in s, path) of every file that a `.pvd` lists, by time.

    Raises:
        ValueError: it is no collection, lists nothing, or points out of its folder.
    """
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
