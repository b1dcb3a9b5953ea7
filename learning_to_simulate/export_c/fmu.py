"""Writes a model as an FMU: FMI 2.0 co-simulation, with its sources and a binary for this machine.

Names of the variables follow Chrono's tyre FMU (`wheel_state.pos.x`, `wheel_load.force.x`); a tool
whose pose is prescribed is called `tool` instead of `wheel`.
"""

import os
import platform
import tempfile
import uuid
import zipfile
from xml.etree import ElementTree

from learning_to_simulate.export_c import c_header, c_library, project

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
_DATE = (1980, 1, 1, 0, 0, 0)  # of every file: equal models give equal FMUs


def write(path: str, name: str, values: dict) -> None:
    """Writes the FMU; without a C compiler it holds sources only.

    Args:
      path: of the file.
      name: of `project.symbol`.
      values: of `model_data.values`, with at least one start.

    Raises:
      ValueError: no start, or a model without a body.
    """
    if not values['n_start'] or not values['n_rigid']:
        raise ValueError('an FMU needs a body, and a start from the training runs')
    with tempfile.TemporaryDirectory() as folder:
        sources = os.path.join(folder, 'sources')
        os.makedirs(sources)
        _write_sources(sources, name, values)
        names = sorted(file for file in os.listdir(sources) if file.endswith('.c'))
        with open(os.path.join(folder, 'modelDescription.xml'), 'wb') as file:
            file.write(model_description(name, values, names))
        project.write_template(
            'fmi2/index.html.in',
            _made(folder, 'documentation/index.html'),
            {'NAME': name, 'BODY': _body(values), 'DT': f'{values["dt"]:.6g}'},
        )
        try:
            binary = _made(folder, f'binaries/{_platform()}/{name}.{_suffix()}')
            c_library.compile_flat(binary, sources)
        except c_library.NoCompiler:
            os.removedirs(os.path.dirname(binary))
        _zip(folder, path)


def guid(values: dict) -> str:
    """The FMU's GUID: it follows the numbers of the model."""
    return '{' + str(uuid.uuid5(uuid.NAMESPACE_OID, values['digest'])) + '}'


def _made(folder, name):
    path = os.path.join(folder, *name.split('/'))
    os.makedirs(os.path.dirname(path), exist_ok=True)
    return path


def _platform():
    system = {'Linux': 'linux', 'Darwin': 'darwin', 'Windows': 'win'}.get(platform.system())
    return f'{system or platform.system().lower()}64'


def _suffix():
    return {'Darwin': 'dylib', 'Windows': 'dll'}.get(platform.system(), 'so')


def _body(values):
    given = values['motion'] == c_header.constants()['LTS_PRESCRIBED']
    return 'tool' if given else 'wheel'


def _write_sources(folder, name, values):
    project.write_sources(folder, name, values)
    for part in ('include/lts.h', 'fmi2/fmi2_soil.c'):
        project.copy(part, folder)
    project.write_template(
        'cmake/model.h.in',
        os.path.join(folder, f'{name}.h'),
        {'NAME': name, 'GUARD': f'{name.upper()}_H', 'DIGEST': values['digest']},
    )
    constants = c_header.constants()
    given = values['motion'] in (constants['LTS_PRESCRIBED'], constants['LTS_DRIVEN'])
    lines = [
        f'/* Generated: what the FMI layer must know of {name}. */',
        f'#include "{name}.h"',
        f'#define FMU_MODEL {name}',
        f'#define FMU_GUID "{guid(values)}"',
        f'#define FMU_CONTEXT {values["n_context"]}',
        f'#define FMU_RIGID {values["n_rigid"]}',
        f'#define FMU_GIVEN {int(given)}',
    ]
    with open(os.path.join(folder, 'fmu_model.h'), 'w', encoding='utf-8') as file:
        file.write('\n'.join([*lines, '']))


def _variables(values):
    """(name, unit, causality, start or None, description) of the reals, in the order of
    fmi2_soil.c."""
    start, body = values['starts'][0], _body(values)
    position, is_driven = start['points'].mean(axis=0), body == 'wheel'
    state, load = f'{body}_state', f'{body}_load'
    rows = [
        (f'{state}.pos.{a}', 'm', 'input', v, 'reference point: the mean of the body points')
        for a, v in zip('xyz', position)
    ]
    rows += [
        (f'{state}.rot.e{i}', None, 'input', float(i == 0), 'rotation from the start attitude')
        for i in range(4)
    ]
    rows += [(f'{state}.lin_vel.{a}', 'm/s', 'input', 0.0, 'of the reference point') for a in 'xyz']
    rows += [(f'{state}.ang_vel.{a}', 'rad/s', 'input', 0.0, 'in the world frame') for a in 'xyz']
    rows += [(f'{load}.point.{a}', 'm', 'output', None, 'where the load is applied') for a in 'xyz']
    rows += [(f'{load}.force.{a}', 'N', 'output', None, 'of the soil on the body') for a in 'xyz']
    rows += [
        (f'{load}.moment.{a}', 'N.m', 'output', None, '0: the model has learned no torque')
        for a in 'xyz'
    ]
    rows += [
        ('sinkage', 'm', 'output' if is_driven else 'local', None, 'height lost since the start'),
        ('drawbar_pull', 'N', 'output', None, 'force along the horizontal velocity'),
        ('step_size', 's', 'constant', values['dt'], 'a frame of the model; never split'),
    ]
    names = values['context_names'].split(',') if values['n_context'] else []
    rows += [(n, None, 'parameter', v, 'of the scene') for n, v in zip(names, start['context'])]
    return rows


def model_description(name: str, values: dict, sources) -> bytes:
    """modelDescription.xml.

    Args:
      name: of the model.
      values: of `model_data.values`.
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
    for file in sources:
        sub(sub_or_new(simulation, 'SourceFiles'), 'File', name=file)
    for unit, parts in _UNITS.items():
        sub(sub(sub_or_new(root, 'UnitDefinitions'), 'Unit', name=unit), 'BaseUnit', **parts)
    for category, text in _LOG_CATEGORIES.items():
        sub(sub_or_new(root, 'LogCategories'), 'Category', name=category, description=text)
    sub(root, 'DefaultExperiment', startTime='0', stopTime='1', stepSize=repr(values['dt']))
    outputs, variables = [], sub(root, 'ModelVariables')
    for vr, (label, unit, causality, start, text) in enumerate(_variables(values)):
        kind = {
            'input': {'causality': 'input', 'variability': 'continuous'},
            'output': {'causality': 'output', 'variability': 'discrete', 'initial': 'calculated'},
            'local': {'causality': 'local', 'variability': 'discrete', 'initial': 'calculated'},
            'constant': {'causality': 'local', 'variability': 'constant', 'initial': 'exact'},
            'parameter': {'causality': 'parameter', 'variability': 'fixed', 'initial': 'exact'},
        }[causality]
        scalar = sub(
            variables,
            'ScalarVariable',
            name=label,
            valueReference=str(vr),
            description=text,
            **kind,
        )
        sub(
            scalar, 'Real', **_given(unit=unit, start=None if start is None else repr(float(start)))
        )
        if causality == 'output':
            outputs.append(len(variables))
    scalar = sub(
        variables, 'ScalarVariable', name='start', valueReference='0', causality='parameter',
        variability='fixed', initial='exact',
        description='which training start; -1: the one whose parameters are nearest',
    )  # fmt: skip
    sub(scalar, 'Integer', min='-1', max=str(values['n_start'] - 1), start='-1')
    for vr, (label, text) in enumerate(_BOOLEANS.items()):
        scalar = sub(
            variables, 'ScalarVariable', name=f'status.{label}', valueReference=str(vr),
            causality='output', variability='discrete', initial='calculated', description=text,
        )  # fmt: skip
        sub(scalar, 'Boolean')
        outputs.append(len(variables))
    scalar = sub(
        variables, 'ScalarVariable', name='digest', valueReference='0', causality='local',
        variability='constant', initial='exact', description='sha256 of the numbers of the model',
    )  # fmt: skip
    sub(scalar, 'String', start=values['digest'])
    structure = sub(root, 'ModelStructure')
    for part in ('Outputs', 'InitialUnknowns'):
        for index in outputs:
            sub(sub_or_new(structure, part), 'Unknown', index=str(index))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='UTF-8', xml_declaration=True)


def sub_or_new(parent, tag):
    """The child of that tag, made if it is not there."""
    found = parent.find(tag)
    return ElementTree.SubElement(parent, tag) if found is None else found


def _given(**attributes):
    return {k: v for k, v in attributes.items() if v is not None}


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
