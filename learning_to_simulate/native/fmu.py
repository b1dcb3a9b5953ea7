"""Writes a model as an FMU of FMI 2.0 (co-simulation): sources, and a binary for this machine."""

import math
import os
import platform
import tempfile
import uuid
import zipfile
from xml.etree import ElementTree

from learning_to_simulate.native import fmu_variables, library, project
from learning_to_simulate.native.fmu_variables import Layout

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
    's': {'s': '1'},
    'deg': {'rad': '1', 'factor': repr(math.pi / 180)},
    'kg/m3': {'kg': '1', 'm': '-3'},
    'm/s2': {'m': '1', 's': '-2'},
}
_LOG_CATEGORIES = {
    'logStatusWarning': 'when the model is used outside its training runs',
    'logStatusError': 'refused input and failed steps',
    'logEvents': 'unused',
}
_CALCULATED = {'variability': 'discrete', 'initial': 'calculated'}
_CAUSALITIES = {
    'input': {'causality': 'input', 'variability': 'continuous'},
    'output': {'causality': 'output', **_CALCULATED},
    'local': {'causality': 'local', **_CALCULATED},
    'constant': {'causality': 'local', 'variability': 'constant', 'initial': 'exact'},
    'parameter': {'causality': 'parameter', 'variability': 'fixed', 'initial': 'exact'},
}


def guid(values: dict, layout: Layout) -> str:
    """The FMU's GUID: it follows the numbers of the model and its variables."""
    what = values['digest'] + ''.join(layout.lines)
    return '{' + str(uuid.uuid5(uuid.NAMESPACE_OID, what)) + '}'


def description(name: str, values: dict, layout: Layout, sources) -> bytes:
    """modelDescription.xml of FMI 2.0, of a model of a name, `model_data.values` or
    `soil_data.values`, its variables and the names of the C files."""
    sub = ElementTree.SubElement
    root = ElementTree.Element(
        'fmiModelDescription', fmiVersion='2.0', modelName=name, guid=guid(values, layout),
        description=f'Soil under a moving {layout.body}',
        generationTool='learning_to_simulate', variableNamingConvention='structured',
        numberOfEventIndicators='0',
    )  # fmt: skip
    can = ('HandleVariableCommunicationStepSize', 'GetAndSetFMUstate', 'SerializeFMUstate')
    able = {f'can{what}': 'true' for what in can}
    if layout.derivatives:
        able['providesDirectionalDerivative'] = 'true'
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
    sub(root, 'DefaultExperiment', startTime='0', stopTime='1', stepSize=repr(layout.dt))
    outputs, variables = [], sub(root, 'ModelVariables')

    def scalar(vr, kind, variable):
        attributes = {
            'name': variable.name, 'valueReference': str(vr), 'description': variable.text
        }  # fmt: skip
        attributes |= _CAUSALITIES[variable.causality]
        if kind == 'Real' and variable.causality == 'output' and layout.derivatives:
            attributes['variability'] = 'continuous'
        found = sub(variables, 'ScalarVariable', **attributes)
        more = dict(variable.limits or {})
        if variable.unit is not None:
            more['unit'] = variable.unit
        if (start := variable.start) is not None:
            more['start'] = start if isinstance(start, str) else repr(float(start))
        sub(found, kind, **more)
        if variable.causality == 'output':
            outputs.append(str(len(variables)))

    for vr, variable in layout.reals.items():
        scalar(vr, 'Real', variable)
    for kind in ('Integer', 'Boolean', 'String'):
        for vr, variable in enumerate(getattr(layout, f'{kind.lower()}s')):
            scalar(vr, kind, variable)
    structure = sub(root, 'ModelStructure')
    for part in ('Outputs', 'InitialUnknowns'):
        parent = sub(structure, part)
        for index in outputs:
            sub(parent, 'Unknown', index=index)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='UTF-8', xml_declaration=True)


def write(path: str, name: str, values: dict, tools: int = 1) -> None:
    """Writes the FMU of a model of a name (`project.symbol`), `model_data.values` or
    `soil_data.values`, and a number of tools on a terrain; without a C compiler it holds sources
    only.

    Raises:
      ValueError: no start, a model without a body, another number of tools, or sources that do not
        compile.
    """
    layout = fmu_variables.of(values, tools)
    with tempfile.TemporaryDirectory() as folder:
        sources = os.path.join(folder, 'sources')
        os.makedirs(sources)
        _write_sources(sources, name, values, layout)
        names = sorted(file for file in os.listdir(sources) if file.endswith('.c'))
        with open(os.path.join(folder, 'modelDescription.xml'), 'wb') as out:
            out.write(description(name, values, layout, names))
        os.makedirs(os.path.join(folder, 'documentation'))
        project.write_template(
            'fmi/index.html.in', os.path.join(folder, 'documentation', 'index.html'),
            {'NAME': name, 'BODY': layout.body} | _about(values),
        )  # fmt: skip
        try:
            binaries = os.path.join(folder, 'binaries', _PLATFORM)
            os.makedirs(binaries)
            library.compile_sources(os.path.join(binaries, f'{name}.{_SUFFIX}'), sources)
        except library.NoCompiler:
            os.removedirs(binaries)
        _zip(folder, path)


def _about(values):
    if project.is_soil(values):
        return {
            'MOMENT': 'The moment is about the point.',
            'STEPS': 'A communication step may last any time. The terrain is level at first and '
            'consists of what the parameters say; heights are told about each tool. Directional '
            'derivatives are those of force and moment in the coming step, which lasts as long as '
            'the last one, by the inputs of the same tool.',
        }
    return {
        'MOMENT': 'The model has learned no torque, and the moment is 0.',
        'STEPS': f'A frame of the model is {values["dt"]:.6g} s and is never split. Shorter '
        'communication steps hold the force, longer ones take several frames.',
    }


def _write_sources(folder, name, values, layout):
    project.write_sources(folder, name, values)
    parts = ('fmu_core.h', 'fmu_core.c', f'fmu_{layout.kind}.h', f'fmu_{layout.kind}.c', 'fmi2.c')
    for part in [*project.headers(values), *(f'fmi/{part}' for part in parts)]:
        project.copy(part, folder)
    project.write_template(
        'cmake/model.h.in', os.path.join(folder, f'{name}.h'), project.words(name, values)
    )
    lines = [
        f'/* Generated: what the FMI layer must know of {name}. */',
        f'#include "{name}.h"',
        f'#define FMU_MODEL {name}',
        f'#define FMU_GUID "{guid(values, layout)}"',
        f'#define FMU_LAYOUT "fmu_{layout.kind}.h"',
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
