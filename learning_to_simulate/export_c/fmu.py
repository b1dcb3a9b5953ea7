"""Writes a model as an FMU of FMI 2.0 (co-simulation): sources, and a binary for this machine.

Names of the variables follow Chrono's tyre FMU (`wheel_state.pos.x`, `wheel_load.force.x`); a tool
whose pose is prescribed is called `tool` instead of `wheel`.
"""

import os
import platform
import tempfile
import zipfile

from learning_to_simulate.export_c import c_header, c_library, fmu_description, project

_DATE = (1980, 1, 1, 0, 0, 0)  # of every file: equal models give equal FMUs


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
            out.write(fmu_description.fmi2(name, values, names))
        project.write_template(
            'fmi/index.html.in',
            _made(folder, 'documentation/index.html'),
            {'NAME': name, 'BODY': fmu_description.body(values), **_about(values)},
        )
        try:
            binary = _made(folder, f'binaries/{_platform()}/{name}.{_suffix()}')
            c_library.compile_flat(binary, sources)
        except c_library.NoCompiler:
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
    c = c_header.constants()
    given = values.get('motion') in (c['LTS_PRESCRIBED'], c['LTS_DRIVEN'])
    lines = [
        f'/* Generated: what the FMI layer must know of {name}. */',
        f'#include "{name}.h"',
        f'#define FMU_MODEL {name}',
        f'#define FMU_GUID "{fmu_description.guid(values)}"',
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
