"""Writes a model as an FMU of FMI 2.0 (co-simulation): sources, and a binary for this machine.

Names of the variables follow Chrono's tyre FMU (`wheel_state.pos.x`, `wheel_load.force.x`); a tool
whose pose is prescribed is called `tool` instead of `wheel`.
"""

import os
import platform
import tempfile
import uuid
import zipfile
from typing import NamedTuple
from xml.etree import ElementTree

from learning_to_simulate.native import library, project

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
_BOOLEANS = {
    'ok': 'nothing of the following has held since the start',
    'extrapolating': 'context, start, pose or speed lies outside the training runs',
    'left_bounds': 'the soil left twice the hull of its training positions',
    'non_finite': 'a position or force is not finite',
}


class Variable(NamedTuple):
    """A scalar variable.

    Attributes:
      name, unit, causality, text: as modelDescription.xml has them; causality 'constant' is a local
        one.
      start: None where it is calculated.
    """

    name: str
    unit: str | None
    causality: str
    text: str
    start: float | None = None


def guid(values: dict) -> str:
    """The FMU's GUID: it follows the numbers of the model."""
    return '{' + str(uuid.uuid5(uuid.NAMESPACE_OID, values['digest'])) + '}'


def body(values: dict) -> str:
    """What the variables call the body."""
    return 'tool' if values['motion'] == library.constants()['LTS_PRESCRIBED'] else 'wheel'


def reals(values: dict) -> list[Variable]:
    """The real variables in the order of fmu_core.h."""
    state, load = f'{body(values)}_state', f'{body(values)}_load'
    point, moment = 'the mean of the body points', '0: the model has learned no torque'
    sinkage = 'output' if body(values) == 'wheel' else 'local'
    place = values['starts'][0]['points'].mean(axis=0)
    return [
        *(Variable(f'{state}.pos.{a}', 'm', 'input', f'reference point: {point}', v)
          for a, v in zip('xyz', place)),
        *(Variable(f'{state}.rot.e{i}', None, 'input', 'rotation from the start attitude',
                   float(i == 0)) for i in range(4)),
        *_vector(f'{state}.lin_vel', 'm/s', 'input', 'of the reference point', 0.0),
        *_vector(f'{state}.ang_vel', 'rad/s', 'input', 'in the world frame', 0.0),
        *_vector(f'{load}.point', 'm', 'output', 'where the load is applied'),
        *_vector(f'{load}.force', 'N', 'output', 'of the soil on the body'),
        *_vector(f'{load}.moment', 'N.m', 'output', moment),
        Variable('sinkage', 'm', sinkage, 'height lost since the start'),
        Variable('drawbar_pull', 'N', 'output', 'force along the horizontal velocity'),
        Variable('step_size', 's', 'constant', 'a frame of the model; never split', values['dt']),
        *_context(values),
    ]  # fmt: skip


def _vector(name, *rest):
    return [Variable(f'{name}.{axis}', *rest) for axis in 'xyz']


def _context(values):
    names = values['context_names'].split(',') if values['n_context'] else []
    return [
        Variable(name, None, 'parameter', 'of the scene', value)
        for name, value in zip(names, values['starts'][0]['context'])
    ]


def description(name: str, values: dict, sources) -> bytes:
    """modelDescription.xml of FMI 2.0.

    Args:
      name: of the model.
      values: of `model_data.values`.
      sources: names of the C files.
    """
    sub = ElementTree.SubElement
    root = ElementTree.Element(
        'fmiModelDescription', fmiVersion='2.0', modelName=name, guid=guid(values),
        description=f'Soil under a moving body, scene {values["name"]}',
        generationTool='learning_to_simulate', variableNamingConvention='structured',
        numberOfEventIndicators='0',
    )  # fmt: skip
    can = ('HandleVariableCommunicationStepSize', 'GetAndSetFMUstate', 'SerializeFMUstate')
    simulation = sub(
        root, 'CoSimulation', modelIdentifier=name, **{f'can{what}': 'true' for what in can}
    )
    listed = sub(simulation, 'SourceFiles')
    for file in sources:
        sub(listed, 'File', name=file)
    units = sub(root, 'UnitDefinitions')
    for unit, parts in _UNITS.items():
        sub(sub(units, 'Unit', name=unit), 'BaseUnit', **parts)
    categories = sub(root, 'LogCategories')
    for category, text in _LOG_CATEGORIES.items():
        sub(categories, 'Category', name=category, description=text)
    sub(root, 'DefaultExperiment', startTime='0', stopTime='1', stepSize=repr(values['dt']))
    outputs, variables = [], sub(root, 'ModelVariables')

    def scalar(vr, kind, variable, **more):
        label, unit, causality, text, start = variable
        attributes = {'name': label, 'valueReference': str(vr), 'description': text}
        found = sub(variables, 'ScalarVariable', **attributes, **_CAUSALITIES[causality])
        more |= {} if unit is None else {'unit': unit}
        if start is not None:
            more['start'] = start if isinstance(start, str) else repr(float(start))
        sub(found, kind, **more)
        if causality == 'output':
            outputs.append(str(len(variables)))

    for vr, variable in enumerate(reals(values)):
        scalar(vr, 'Real', variable)
    text = 'which training start; -1: the one whose parameters are nearest'
    most = str(values['n_start'] - 1)
    scalar(0, 'Integer', Variable('start', None, 'parameter', text, '-1'), min='-1', max=most)
    for vr, (label, text) in enumerate(_BOOLEANS.items()):
        scalar(vr, 'Boolean', Variable(f'status.{label}', None, 'output', text))
    text = 'sha256 of the numbers of the model'
    scalar(0, 'String', Variable('digest', None, 'constant', text, values['digest']))
    structure = sub(root, 'ModelStructure')
    for part in ('Outputs', 'InitialUnknowns'):
        parent = sub(structure, part)
        for index in outputs:
            sub(parent, 'Unknown', index=index)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='UTF-8', xml_declaration=True)


def write(path: str, name: str, values: dict) -> None:
    """Writes the FMU; without a C compiler it holds sources only.

    Args:
      path: of the file.
      name: of `project.symbol`.
      values: of `model_data.values`, with at least one start.

    Raises:
      ValueError: no start, a model without a body, or sources that do not compile.
    """
    if not (values['n_start'] and values['n_rigid']):
        raise ValueError('an FMU needs a body, and a start from the training runs')
    with tempfile.TemporaryDirectory() as folder:
        sources = os.path.join(folder, 'sources')
        os.makedirs(sources)
        _write_sources(sources, name, values)
        names = sorted(file for file in os.listdir(sources) if file.endswith('.c'))
        with open(os.path.join(folder, 'modelDescription.xml'), 'wb') as out:
            out.write(description(name, values, names))
        os.makedirs(os.path.join(folder, 'documentation'))
        project.write_template(
            'fmi/index.html.in', os.path.join(folder, 'documentation', 'index.html'),
            {'NAME': name, 'BODY': body(values), 'DT': f'{values["dt"]:.6g}'},
        )  # fmt: skip
        try:
            binaries = os.path.join(folder, 'binaries', _PLATFORM)
            os.makedirs(binaries)
            library.compile_sources(os.path.join(binaries, f'{name}.{_SUFFIX}'), sources)
        except library.NoCompiler:
            os.removedirs(binaries)
        _zip(folder, path)


def _write_sources(folder, name, values):
    project.write_sources(folder, name, values)
    parts = [f'fmi/{part}' for part in ('fmu_core.h', 'fmu_core.c', 'fmi2.c')]
    for part in [*project.headers(values), *parts]:
        project.copy(part, folder)
    project.write_template(
        'cmake/model.h.in', os.path.join(folder, f'{name}.h'), project.words(name, values)
    )
    c = library.constants()
    given = values['motion'] in (c['LTS_PRESCRIBED'], c['LTS_DRIVEN'])
    lines = [
        f'/* Generated: what the FMI layer must know of {name}. */',
        f'#include "{name}.h"',
        f'#define FMU_MODEL {name}',
        f'#define FMU_GUID "{guid(values)}"',
        f'#define FMU_CONTEXT {values["n_context"]}',
        f'#define FMU_GIVEN {int(given)}',
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
