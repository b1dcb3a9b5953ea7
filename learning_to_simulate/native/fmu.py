"""Writes a soil field as an FMU of FMI 2.0 (co-simulation): sources, and a binary for this machine.

Variables are numbered as modelDescription.xml and the C code of `c/fmi` number them. Names follow
Chrono's tyre FMU (`wheel_state.pos.x`, `wheel_load.force.x`); a tool whose pose is prescribed is
called `tool` instead of `wheel`.
"""

import math
import os
import platform
import tempfile
import uuid
import zipfile
from typing import NamedTuple
from xml.etree import ElementTree

from learning_to_simulate.native import library, project
from learning_to_simulate.soil_field.tools import TOOLS, Soil

# Places at which heights are told, along and across (fmu.c), and what the terrain is at first, m.
HEIGHTS = (9, 5)
TERRAIN: dict = {'size': (4.0, 2.0), 'cell': 0.02, 'height': 0.0, 'depth': 1.0, 'grid': 0.1}
STEP = 0.01  # s, step of the default experiment


class Variable(NamedTuple):
    """A scalar variable as modelDescription.xml has it; causality 'constant' is a local one.
    `start` is None where it is calculated."""

    name: str
    unit: str | None
    causality: str
    text: str
    start: float | str | None = None
    kind: str = 'Real'


class Layout(NamedTuple):
    """What an FMU has.

    Attributes:
      body: what its variables call the body.
      variables: value reference of each, and what it is.
      lines: of fmu_model.h, with first value and kind of each real.
    """

    body: str
    variables: list[tuple[int, Variable]]
    lines: list[str]


def _vector(name, *rest):
    return [Variable(f'{name}.{axis}', *rest) for axis in 'xyz']


# Causality -> kind of a real in fmu.c.
_KINDS = {'input': 'FMU_INPUT', 'output': 'FMU_OUTPUT', 'parameter': 'FMU_PARAMETER'}
_SHAPE = {
    'width': ('m', 'across the way'),
    'radius': ('m', 'of the lower edge, or of the rim between grousers'),
    'length': ('m', 'height of the outline over the edge'),
    'bucket': (None, '1 of a shell that is open to the front, 0 of a flat blade'),
    'plates': (None, '1 where the ends of a bucket are closed, else 0'),
    'floor_deg': ('deg', 'rise of the underside of a bucket behind its edge'),
    'floor_share': (None, 'length of that underside over the height'),
    'lugs': (None, 'number of grousers'),
    'lug_height': ('m', 'of the grousers'),
}  # as in lts_soil_tool
_SPREADS = ('along', 'up', 'across')
_BOOLEANS = {
    'ok': 'all frames since the start resemble the training runs',
    'ok_now': 'the newest frame resembles them',
    'extrapolating': 'tool, soil, terrain, pose or speed lies outside the training runs',
    'non_finite': 'a force is not finite',
}


def layout_of(values: dict, tools: int = 1) -> Layout:
    """The layout of `soil_data.values` with a number of tools; ValueError for another number."""
    if not 1 <= tools <= 16:
        raise ValueError(f'tools is {tools}: 1 to 16 tools can work on the terrain of an FMU')
    is_wheel = values['kind'] == library.constants()['LTS_SOIL_WHEEL']
    body, tool = ('wheel', TOOLS['wheel']()) if is_wheel else ('tool', TOOLS['blade']())
    reals: dict[int, Variable] = {}
    digest = 'sha256 of the numbers of the model'
    integers, booleans = [], []
    strings = [Variable('digest', None, 'constant', digest, values['digest'], 'String')]
    (length, across), count = TERRAIN['size'], 0
    names = enumerate(values['judged_names'].split(','), 1)
    measures = ', '.join(f'{number} {name}' for number, name in names)
    reason = f'what first left its range since the start: {measures}; 0 nothing, -1 not finite'
    for k in range(tools):
        place = (0.75 * length, tool.radius + 0.05, across * (k + 0.5) / tools)
        index = f'[{k + 1}]' if tools > 1 else ''
        for at, variable in enumerate(_of_tool(body, index, place, tool), count):
            if variable is not None:
                reals[at] = variable
        count += N_OF_TOOL
        status = f'status{index}.'
        integers.append(Variable(f'{status}reason', None, 'output', reason, kind='Integer'))
        booleans += [
            Variable(status + label, None, 'output', text, kind='Boolean')
            for label, text in _BOOLEANS.items()
        ]
        in_words = 'the same in words'
        strings.append(Variable(f'{status}text', None, 'output', in_words, kind='String'))
    ground = _ground()
    reals |= dict(enumerate(ground, count))
    rows = [reals.get(at) for at in range(count + len(ground))]
    first = (float(row.start) if row and row.start is not None else 0.0 for row in rows)
    kinds = (_KINDS[row.causality] if row else 'FMU_NONE' for row in rows)
    tables = {'FIRST': first, 'KINDS': kinds}
    lines = [f'#define FMU_{n} {{{", ".join(map(str, table))}}}' for n, table in tables.items()]
    lines = [f'#define FMU_TOOLS {tools}', f'#define FMU_STEP {STEP!r}', *lines]
    others = [numbered for some in (integers, booleans, strings) for numbered in enumerate(some)]
    return Layout(body, [*reals.items(), *others], lines)


N_OF_TOOL = 32 + HEIGHTS[0] * HEIGHTS[1] + len(_SHAPE)  # VR_TOOL of fmu.c


def _of_tool(body, index, place, tool):
    """Variables by value reference within a tool; None where there is none."""
    state, load = f'{body}_state{index}', f'{body}_load{index}'
    point = 'reference point: the middle of the ' + ('lower edge' if body == 'tool' else 'axle')
    attitude = 'rotation from upright, looking along -x'
    spread = 'standard deviation over the networks of the model'
    return [
        *(Variable(f'{state}.pos.{axis}', 'm', 'input', point, start)
          for axis, start in zip('xyz', place, strict=True)),
        *(Variable(f'{state}.rot.e{i}', None, 'input', attitude, float(i == 0)) for i in range(4)),
        *_vector(f'{state}.lin_vel', 'm/s', 'input', 'of the reference point', 0.0),
        *_vector(f'{state}.ang_vel', 'rad/s', 'input', 'in the world frame', 0.0),
        *_vector(f'{load}.point', 'm', 'output', 'where the load is applied'),
        *_vector(f'{load}.force', 'N', 'output', 'of the soil on the body'),
        *_vector(f'{load}.moment', 'N.m', 'output', 'about the point'),
        *(Variable(f'{load}.{part}_spread.{way}', unit, 'output', spread)
          for part, unit in (('force', 'N'), ('moment', 'N.m')) for way in _SPREADS),
        Variable(f'force_bound{index}', 'N', 'output',
                 'of its error, kept by most frames like those of training; -1: unknown'),
        Variable(f'sinkage{index}', 'm', 'output',
                 'depth of the lowest point under the terrain as it began'),
        Variable(f'drawbar_pull{index}', 'N', 'output', 'force along the way the tool looks'),
        Variable(f'payload{index}', 'm3', 'output', 'soil in a bucket, which weighs on it'),
        *(Variable(f'ground{index}.height[{i + 1},{j + 1}]', 'm', 'output',
                   f'of the terrain, {i - HEIGHTS[0] // 2} terrain.grid ahead of the tool and '
                   f'{j - HEIGHTS[1] // 2} across')
          for i in range(HEIGHTS[0]) for j in range(HEIGHTS[1])),
        *(Variable(f'{body}{index}.{part}', unit, 'parameter', text, float(getattr(tool, part)))
          if hasattr(tool, part) else None for part, (unit, text) in _SHAPE.items()),
    ]  # fmt: skip


def _ground():
    soil, (length, across) = Soil(), TERRAIN['size']
    own = {
        'terrain.size.x': ('m', 'of the terrain, which begins at x = 0', length),
        'terrain.size.z': ('m', 'of the terrain, which begins at z = 0', across),
        'terrain.cell': ('m', 'side of a cell', TERRAIN['cell']),
        'terrain.height': ('m', 'of the level terrain at first', TERRAIN['height']),
        'terrain.depth': ('m', 'of the soil over its floor', TERRAIN['depth']),
        'soil.friction_angle_deg': ('deg', 'of the soil', soil.friction_angle_deg),
        'soil.density': ('kg/m3', 'of the soil in bulk', soil.density),
        'soil.gravity': ('m/s2', 'acceleration', soil.gravity),
        'terrain.grid': ('m', 'distance of the places at which heights are told', TERRAIN['grid']),
    }
    return [
        Variable(name, unit, 'parameter', text, float(start))
        for name, (unit, text, start) in own.items()
    ]


# ---- the files ----

_DATE = (1980, 1, 1, 0, 0, 0)  # of every file: equal models give equal FMUs
_SYSTEM = platform.system()
_PLATFORM = {'Linux': 'linux64', 'Darwin': 'darwin64', 'Windows': 'win64'}.get(
    _SYSTEM, f'{_SYSTEM.lower()}64'
)
_SUFFIX = {'Darwin': 'dylib', 'Windows': 'dll'}.get(_SYSTEM, 'so')
_UNITS = {
    'm': {'m': '1'},
    'm/s': {'m': '1', 's': '-1'},
    'rad/s': {'rad': '1', 's': '-1'},
    'N': {'kg': '1', 'm': '1', 's': '-2'},
    'N.m': {'kg': '1', 'm': '2', 's': '-2'},
    'deg': {'rad': '1', 'factor': repr(math.pi / 180)},
    'kg/m3': {'kg': '1', 'm': '-3'},
    'm3': {'m': '3'},
    'm/s2': {'m': '1', 's': '-2'},
}
_LOG_CATEGORIES = {
    'logStatusWarning': 'when the model is used outside its training runs',
    'logStatusError': 'refused input and failed steps',
}
_CALCULATED = {'variability': 'discrete', 'initial': 'calculated'}
_CAUSALITIES = {
    'input': {'causality': 'input', 'variability': 'continuous'},
    'output': {'causality': 'output', **_CALCULATED},
    'constant': {'causality': 'local', 'variability': 'constant', 'initial': 'exact'},
    'parameter': {'causality': 'parameter', 'variability': 'fixed', 'initial': 'exact'},
}


def guid(values: dict, layout: Layout) -> str:
    """The FMU's GUID: it follows the numbers of the model and its variables."""
    what = values['digest'] + ''.join(layout.lines)
    return '{' + str(uuid.uuid5(uuid.NAMESPACE_OID, what)) + '}'


def description(name: str, values: dict, layout: Layout, sources) -> bytes:
    """modelDescription.xml of FMI 2.0, of a model of a name, `soil_data.values`, its variables and
    the names of the C files."""
    sub = ElementTree.SubElement
    root = ElementTree.Element(
        'fmiModelDescription', fmiVersion='2.0', modelName=name, guid=guid(values, layout),
        description=f'Soil under a moving {layout.body}',
        generationTool='learning_to_simulate', variableNamingConvention='structured',
        numberOfEventIndicators='0',
    )  # fmt: skip
    can = ('HandleVariableCommunicationStepSize', 'GetAndSetFMUstate', 'SerializeFMUstate')
    able = {f'can{what}': 'true' for what in can} | {'providesDirectionalDerivative': 'true'}
    simulation = sub(root, 'CoSimulation', modelIdentifier=name, **able)
    listed = sub(simulation, 'SourceFiles')
    for file in sources:
        sub(listed, 'File', name=file)
    units = sub(root, 'UnitDefinitions')
    for unit, parts in _UNITS.items():
        sub(sub(units, 'Unit', name=unit), 'BaseUnit', **parts)
    categories = sub(root, 'LogCategories')
    for category, text in _LOG_CATEGORIES.items():
        sub(categories, 'Category', name=category, description=text)
    sub(root, 'DefaultExperiment', startTime='0', stopTime='1', stepSize=repr(STEP))
    outputs, variables = [], sub(root, 'ModelVariables')
    for vr, variable in layout.variables:
        attributes = {
            'name': variable.name, 'valueReference': str(vr), 'description': variable.text
        }  # fmt: skip
        attributes |= _CAUSALITIES[variable.causality]
        if variable.kind == 'Real' and variable.causality == 'output':
            attributes['variability'] = 'continuous'
        found = sub(variables, 'ScalarVariable', **attributes)
        more = {} if variable.unit is None else {'unit': variable.unit}
        if (start := variable.start) is not None:
            more['start'] = start if isinstance(start, str) else repr(start)
        sub(found, variable.kind, **more)
        if variable.causality == 'output':
            outputs.append(str(len(variables)))
    structure = sub(root, 'ModelStructure')
    for part in ('Outputs', 'InitialUnknowns'):
        parent = sub(structure, part)
        for index in outputs:
            sub(parent, 'Unknown', index=index)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='UTF-8', xml_declaration=True)


def write(path: str, name: str, values: dict, tools: int = 1) -> None:
    """Writes the FMU of a soil field of a name (`project.symbol`), `soil_data.values`, and a number
    of tools on a terrain; without a C compiler it holds sources only.

    Raises:
      ValueError: another number of tools, or sources that do not compile.
    """
    layout = layout_of(values, tools)
    with tempfile.TemporaryDirectory() as folder:
        sources = os.path.join(folder, 'sources')
        os.makedirs(sources)
        project.write_sources(sources, name, values)
        project.copy('fmi/fmu.c', sources)
        _write_header(sources, name, values, layout)
        names = sorted(file for file in os.listdir(sources) if file.endswith('.c'))
        with open(os.path.join(folder, 'modelDescription.xml'), 'wb') as out:
            out.write(description(name, values, layout, names))
        os.makedirs(os.path.join(folder, 'documentation'))
        project.write_template(
            'fmi/index.html.in', os.path.join(folder, 'documentation', 'index.html'),
            {'NAME': name, 'BODY': layout.body},
        )  # fmt: skip
        try:
            binaries = os.path.join(folder, 'binaries', _PLATFORM)
            os.makedirs(binaries)
            library.compile_sources(os.path.join(binaries, f'{name}.{_SUFFIX}'), sources)
        except library.NoCompiler:
            os.removedirs(binaries)
        _zip(folder, path)


def _write_header(folder, name, values, layout):
    lines = [
        f'/* Generated: what the FMI layer must know of {name}. */',
        f'#include "{name}.h"',
        f'#define FMU_MODEL {name}',
        f'#define FMU_GUID "{guid(values, layout)}"',
        *layout.lines,
    ]
    with open(os.path.join(folder, 'fmu_model.h'), 'w', encoding='utf-8') as file:
        file.write('\n'.join([*lines, '']))


def _zip(folder, path):
    with zipfile.ZipFile(path, 'w', zipfile.ZIP_DEFLATED) as archive:
        for root, folders, names in os.walk(folder):
            folders.sort()
            for file in sorted(names):
                whole = os.path.join(root, file)
                entry = zipfile.ZipInfo(os.path.relpath(whole, folder), _DATE)
                entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
                with open(whole, 'rb') as content:
                    archive.writestr(entry, content.read())
