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

import numpy as np

from learning_to_simulate.native import library, project

_DATE = (1980, 1, 1, 0, 0, 0)  # of every file: equal models give equal FMUs
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
_BOOLEANS = {
    'ok': 'nothing of the following has held since the start',
    'extrapolating': 'context, start, pose or speed lies outside the training runs',
    'left_bounds': 'the soil left twice the hull of its training positions',
    'non_finite': 'a position or force is not finite',
}


class Variable(NamedTuple):
    """A scalar variable.

    Attributes:
      name, unit, text: as they are told.
      causality: input, output, local, constant or parameter.
      start: or None where it is calculated.
    """

    name: str
    unit: str | None
    causality: str
    start: float | None
    text: str


def guid(values: dict) -> str:
    """The FMU's GUID: it follows the numbers of the model."""
    return '{' + str(uuid.uuid5(uuid.NAMESPACE_OID, values['digest'])) + '}'


def body(values: dict) -> str:
    """What the variables call the body."""
    given = values.get('motion', 1) == library.constants()['LTS_PRESCRIBED']
    return 'tool' if given and not project.is_wheel(values) else 'wheel'


def _context(values):
    """Parameters, and inputs that are values of the scene."""
    if project.is_field(values) and not project.is_wheel(values):
        return [Variable('blade_width', 'm', 'parameter', values['width'], 'of the blade')]
    names = values['context_names'].split(',') if values['n_context'] else []
    found = [
        Variable(name, None, 'parameter', value, 'of the scene')
        for name, value in zip(names, values['starts'][0]['context'])
    ]
    if project.is_wheel(values):
        load = values['load']
        found[load] = found[load]._replace(unit='N', causality='input', text='on the wheel')
    return found


def _first_place(values):
    if project.is_wheel(values):
        return values['starts'][0]['pose'][:3]
    if not project.is_field(values):
        return values['starts'][0]['points'].mean(axis=0)
    place = np.empty(3)
    place[values['axis']] = values['sign'] * values['start_u']
    place[values['up']] = values['start_height'] + values['blade_radius'] + 0.01
    place[3 - values['axis'] - values['up']] = values['middle']
    return place


def reals(values: dict) -> list[Variable]:
    """The real variables in the order of fmu_core.h."""
    is_field, called = project.is_field(values), body(values)
    state, load = f'{called}_state', f'{called}_load'
    point = 'the middle of the lower edge' if is_field else 'the mean of the body points'
    if project.is_wheel(values):
        point = 'the axle, its height predicted'
    attitude = 'rotation from upright' if is_field else 'rotation from the start attitude'
    moment = 'about the point' if is_field else '0: the model has learned no torque'
    bound = (
        'root mean square error per component, kept by 95 % of frames like those of validation'
        if is_field
        else '0: the model has no bound'
    )
    frame = (
        'of the training; a step may last any time'
        if is_field
        else 'a frame of the model; never split'
    )
    rows = [
        Variable(f'{state}.pos.{a}', 'm', 'input', v, f'reference point: {point}')
        for a, v in zip('xyz', _first_place(values))
    ]
    rows += [
        Variable(f'{state}.rot.e{i}', None, 'input', float(i == 0), attitude) for i in range(4)
    ]
    for part, unit, text in (('lin_vel', 'm/s', 'of the reference point'),
                             ('ang_vel', 'rad/s', 'in the world frame')):  # fmt: skip
        rows += [Variable(f'{state}.{part}.{a}', unit, 'input', 0.0, text) for a in 'xyz']
    for part, unit, text in (('point', 'm', 'where the load is applied'),
                             ('force', 'N', 'of the soil on the body'),
                             ('moment', 'N.m', moment)):  # fmt: skip
        rows += [Variable(f'{load}.{part}.{a}', unit, 'output', None, text) for a in 'xyz']
    sinks = 'output' if called == 'wheel' else 'local'
    rows += [
        Variable('sinkage', 'm', sinks, None, 'height lost since the start'),
        Variable('drawbar_pull', 'N', 'output', None, 'force along the horizontal velocity'),
        Variable('force_bound', 'N', 'output' if is_field else 'local', None, bound),
        Variable('step_size', 's', 'constant', values['dt'], frame),
    ]
    return rows + _context(values)


def _attributes(causality):
    return {
        'input': {'causality': 'input', 'variability': 'continuous'},
        'output': {'causality': 'output', 'variability': 'discrete', 'initial': 'calculated'},
        'local': {'causality': 'local', 'variability': 'discrete', 'initial': 'calculated'},
        'constant': {'causality': 'local', 'variability': 'constant', 'initial': 'exact'},
        'parameter': {'causality': 'parameter', 'variability': 'fixed', 'initial': 'exact'},
    }[causality]


def _start_range(values):
    return {'min': '-1', 'max': str(values.get('n_start', 1) - 1), 'start': '-1'}


_START_TEXT = 'which training start; -1: the one whose parameters are nearest'
_DIGEST_TEXT = 'sha256 of the numbers of the model'


def _common(root, values):
    sub = ElementTree.SubElement
    parent = sub(root, 'UnitDefinitions')
    for unit, parts in _UNITS.items():
        sub(sub(parent, 'Unit', name=unit), 'BaseUnit', **parts)
    parent = sub(root, 'LogCategories')
    for category, text in _LOG_CATEGORIES.items():
        sub(parent, 'Category', name=category, description=text)
    sub(root, 'DefaultExperiment', startTime='0', stopTime='1', stepSize=repr(values['dt']))


def description(name: str, values: dict, sources) -> bytes:
    """modelDescription.xml of FMI 2.0.

    Args:
      name: of the model.
      values: of `model_data.values` or `field_data.values`.
      sources: names of the C files.
    """
    element, sub = ElementTree.Element, ElementTree.SubElement
    root = element(
        'fmiModelDescription',
        fmiVersion='2.0',
        modelName=name,
        guid=guid(values),
        description=f'Soil under a moving body, scene {values["name"]}',
        generationTool='learning_to_simulate',
        variableNamingConvention='structured',
        numberOfEventIndicators='0',
    )
    simulation = sub(
        root,
        'CoSimulation',
        modelIdentifier=name,
        canHandleVariableCommunicationStepSize='true',
        canGetAndSetFMUstate='true',
        canSerializeFMUstate='true',
    )
    listed = sub(simulation, 'SourceFiles')
    for file in sources:
        sub(listed, 'File', name=file)
    _common(root, values)
    outputs, variables = [], sub(root, 'ModelVariables')

    def scalar(vr, label, text, kind, causality, **attributes):
        found = sub(
            variables, 'ScalarVariable', name=label, valueReference=str(vr), description=text,
            **_attributes(causality),
        )  # fmt: skip
        sub(found, kind, **_given(**attributes))
        if causality == 'output':
            outputs.append(len(variables))

    for vr, v in enumerate(reals(values)):
        start = None if v.start is None else repr(float(v.start))
        scalar(vr, v.name, v.text, 'Real', v.causality, unit=v.unit, start=start)
    scalar(0, 'start', _START_TEXT, 'Integer', 'parameter', **_start_range(values))
    for vr, (label, text) in enumerate(_BOOLEANS.items()):
        scalar(vr, f'status.{label}', text, 'Boolean', 'output')
    scalar(0, 'digest', _DIGEST_TEXT, 'String', 'constant', start=values['digest'])
    structure = sub(root, 'ModelStructure')
    for part in ('Outputs', 'InitialUnknowns'):
        parent = sub(structure, part)
        for index in outputs:
            sub(parent, 'Unknown', index=str(index))
    return _text(root)


def _given(**attributes):
    return {k: v for k, v in attributes.items() if v is not None}


def _text(root):
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='UTF-8', xml_declaration=True)


def write(path: str, name: str, values: dict) -> None:
    """Writes the FMU; without a C compiler it holds sources only.

    Args:
      path: of the file.
      name: of `project.symbol`.
      values: of `model_data.values`, with at least one start, or of `field_data.values`.

    Raises:
      ValueError: no start, a model without a body, or sources that do not compile.
    """
    if not project.is_field(values) and not (values['n_start'] and values['n_rigid']):
        raise ValueError('an FMU needs a body, and a start from the training runs')
    with tempfile.TemporaryDirectory() as folder:
        sources = os.path.join(folder, 'sources')
        os.makedirs(sources)
        _write_sources(sources, name, values)
        names = sorted(file for file in os.listdir(sources) if file.endswith('.c'))
        with open(os.path.join(folder, 'modelDescription.xml'), 'wb') as out:
            out.write(description(name, values, names))
        project.write_template(
            'fmi/index.html.in',
            _made(folder, 'documentation/index.html'),
            {'NAME': name, 'BODY': body(values), **_about(values)},
        )
        try:
            binary = _made(folder, f'binaries/{_platform()}/{name}.{_suffix()}')
            library.compile_flat(binary, sources)
        except library.NoCompiler:
            os.removedirs(os.path.dirname(binary))
        _zip(folder, path)


def _about(values):
    """What the documentation says of a kind of model."""
    if project.is_field(values):
        begins = (
            ' The wheel begins where the recorded one of `start` stood, in its own print: its '
            'place is wheel_load.point; the height of wheel_state.pos is ignored.'
        )
        return {
            'MOMENT': 'The moment is about the point.',
            'STEPS': 'A communication step may last any time: nothing is integrated.'
            + begins * project.is_wheel(values),
        }
    return {
        'MOMENT': 'The model has learned no torque, and the moment is 0.',
        'STEPS': f'A frame of the model is {values["dt"]:.6g} s and is never split. Shorter '
        'communication steps hold the force, longer ones take several frames.',
    }


def _made(folder, name):
    path = os.path.join(folder, *name.split('/'))
    os.makedirs(os.path.dirname(path), exist_ok=True)
    return path


def _platform():
    system = {'Linux': 'linux', 'Darwin': 'darwin', 'Windows': 'win'}.get(platform.system())
    return f'{system or platform.system().lower()}64'


def _suffix():
    return {'Darwin': 'dylib', 'Windows': 'dll'}.get(platform.system(), 'so')


def _write_sources(folder, name, values):
    project.write_sources(folder, name, values)
    kind = 'field' if project.is_field(values) else 'graph'
    parts = ['fmu_core.h', 'fmu_core.c', f'fmu_{kind}.c', 'fmi2.c']
    for part in [*project.headers(values), *(f'fmi/{part}' for part in parts)]:
        project.copy(part, folder)
    project.write_template(
        'cmake/model.h.in', os.path.join(folder, f'{name}.h'), project.words(name, values)
    )
    c = library.constants()
    given = values.get('motion') in (c['LTS_PRESCRIBED'], c['LTS_DRIVEN'])
    lines = [
        f'/* Generated: what the FMI layer must know of {name}. */',
        f'#include "{name}.h"',
        f'#define FMU_MODEL {name}',
        f'#define FMU_GUID "{guid(values)}"',
        f'#define FMU_CONTEXT {values.get("n_context", 1)}',
        '/* Which value of the context is an input; -1: none. */',
        f'#define FMU_LOAD {values["load"] if project.is_wheel(values) else -1}',
        f'#define FMU_RIGID {values.get("n_rigid", 0)}',
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
