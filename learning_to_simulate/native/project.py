"""Writes a model as a C project: sources, header, CMake and pkg-config files, examples."""

import functools
import glob
import hashlib
import os
import re
import shutil

from learning_to_simulate.native import c_values, library
from learning_to_simulate.native.model_data import MOTIONS

VERSION = '1.0.0'  # of the C interface; its first number is LTS_ABI
# Template in c/ -> file of the project, of all models, of those in a subspace, of soil fields;
# @NAME@ is the model's.
_TEMPLATES = {
    'cmake/CMakeLists.txt.in': 'CMakeLists.txt',
    'cmake/model.h.in': 'include/@NAME@.h',
}
_GRAPH_TEMPLATES = {
    'cmake/README.md.in': 'README.md',
    'examples/example.cpp.in': 'examples/example.cpp',
    'examples/loop_1khz.c.in': 'examples/loop_1khz.c',
    'examples/ros2_node.cpp.in': 'examples/ros2_node.cpp',
}
_SOIL_TEMPLATES = {
    'cmake/README_soil.md.in': 'README.md',
    'examples/soil.cpp.in': 'examples/example.cpp',
    'examples/loop_soil.c.in': 'examples/loop_1khz.c',
    'examples/ros2_soil.cpp.in': 'examples/ros2_node.cpp',
}
# Sources of both kinds of models; those of soil fields alone begin with `lts_soil`.
_SHARED = ('lts_common', 'lts_kernels', 'lts_model.')


def is_soil(values: dict) -> bool:
    """Whether values are those of `soil_data.values`."""
    return 'n_column' in values


def symbol(model_path: str) -> str:
    """Name of a model in C: `lts_` and the last two folders of its path; with eight digits of their
    digest where they give no letters or a name that the library has itself."""
    path = '_'.join(os.path.abspath(model_path).split(os.sep)[-2:])
    plain = re.sub(r'\W+', '_', path, flags=re.ASCII).strip('_').lower()
    if plain and f'lts_{plain}' not in _library_names():
        return f'lts_{plain}'
    digest = hashlib.sha256(os.fsencode(path)).hexdigest()[:8]
    return '_'.join(['lts', *[plain] * bool(plain), digest])


@functools.cache
def _library_names():
    """Types, functions and files of the library."""
    found = set()
    for path in glob.glob(os.path.join(library.SOURCES, '*', '*')):
        found.add(os.path.basename(path).partition('.')[0])
        with open(path, encoding='utf-8') as file:
            found.update(re.findall(r'\blts_\w+', file.read()))
    return found


def write_sources(folder: str, name: str, values: dict) -> None:
    """The C files of a model of a name and of the library, in one folder that exists."""
    for part in sorted(os.listdir(os.path.join(library.SOURCES, 'src'))):
        if part.startswith(_SHARED) or part.startswith('lts_soil') == is_soil(values):
            copy(f'src/{part}', folder)
    with open(os.path.join(folder, f'{name}.c'), 'w', encoding='utf-8') as file:
        file.write(model_source(name, values))


def headers(values: dict) -> list[str]:
    """The public headers, in native/."""
    return ['include/lts.h', *['include/lts_soil.h'] * is_soil(values)]


def model_source(name: str, values: dict) -> str:
    """The generated C file: weights, ranges, starts and subspace as constants."""
    kind = words(name, values)['STRUCT']
    return (
        f'/* Generated from a trained model; digest {values["digest"]}. */\n'
        f'#include "{name}.h"\n#include "{kind}.h"\n\n'
        '#if defined(__GNUC__)\n#define LTS_ALIGNED __attribute__((aligned(64)))\n'
        '#else\n#define LTS_ALIGNED\n#endif\n\n' + c_values.Structure(kind, values).source(name)
    )


def write(folder: str, name: str, values: dict) -> None:
    """Writes the project into a folder that exists and is empty.

    Args:
      name: of `symbol`.
      values: of `model_data.values` or `soil_data.values`.
    """
    for part in ('include', 'src', 'examples'):
        os.makedirs(os.path.join(folder, part))
    for header in headers(values):
        copy(header, os.path.join(folder, 'include'))
    write_sources(os.path.join(folder, 'src'), name, values)
    more = _SOIL_TEMPLATES if is_soil(values) else _GRAPH_TEMPLATES
    for template, target in (_TEMPLATES | more).items():
        path = os.path.join(folder, target.replace('@NAME@', name))
        write_template(template, path, words(name, values))


def words(name: str, values: dict) -> dict:
    """What the templates say of a model."""
    found = {
        'NAME': name,
        'GUARD': f'{name.upper()}_H',
        'VERSION': VERSION,
        'DIGEST': values['digest'],
    }
    if is_soil(values):
        wheel = values['kind'] == library.constants()['LTS_SOIL_WHEEL']
        return found | {
            'HEADER': 'lts_soil.h',
            'STRUCT': 'lts_soil_model',
            'MEMBERS': values['n_member'],
            'TOOL': 'wheel' if wheel else 'blade',
        }
    return found | {
        'HEADER': 'lts.h',
        'STRUCT': 'lts_model',
        'SCENE': values['name'],
        'SOIL': values.get('n_soil', 0),
        'DT': f'{values["dt"]:.6g}',
        'RATE': f'{1 / values["dt"]:.4g}',
        'RIGID': values['n_rigid'],
        'MOTION': MOTIONS[values['motion']].value,
        'MODES': values['n_modes'],
        'STARTS': values['n_start'],
        'CONTEXT': values['context_names'].replace(',', ', ') or 'none',
    }


def copy(part: str, folder: str) -> None:
    shutil.copy(os.path.join(library.SOURCES, part), folder)


def write_template(template: str, target: str, words: dict) -> None:
    """Writes a file of native/ with each @WORD@ replaced; KeyError for a word that is not given."""
    with open(os.path.join(library.SOURCES, template), encoding='utf-8') as file:
        text = re.sub(r'@([A-Z_]+)@', lambda match: str(words[match[1]]), file.read())
    with open(target, 'w', encoding='utf-8') as file:
        file.write(text)
