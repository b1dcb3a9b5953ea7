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
# File of the project -> its template in c/, of models in a subspace and of soil fields.
_TEMPLATES = {
    'CMakeLists.txt': ('cmake/CMakeLists.txt.in', 'cmake/CMakeLists.txt.in'),
    'README.md': ('cmake/README.md.in', 'cmake/README_soil.md.in'),
    'examples/example.cpp': ('examples/example.cpp.in', 'examples/soil.cpp.in'),
    'examples/loop_1khz.c': ('examples/loop_1khz.c.in', 'examples/loop_soil.c.in'),
    'examples/ros2_node.cpp': ('examples/ros2_node.cpp.in', 'examples/ros2_soil.cpp.in'),
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


def write_sources(folder: str, name: str, values: dict, include: str | None = None) -> None:
    """The C files of a model of a name and of the library into a folder, and the public headers
    into another (None: the same); both exist."""
    include = include or folder
    for part in sorted(os.listdir(os.path.join(library.SOURCES, 'src'))):
        if part.startswith(_SHARED) or part.startswith('lts_soil') == is_soil(values):
            copy(f'src/{part}', folder)
    for header in ['lts.h', *['lts_soil.h'] * is_soil(values)]:
        copy(f'include/{header}', include)
    said = words(name, values)
    write_template('cmake/model.h.in', os.path.join(include, f'{name}.h'), said)
    kind = said['STRUCT']
    text = (
        f'/* Generated from a trained model; digest {values["digest"]}. */\n'
        f'#include "{name}.h"\n#include "{kind}.h"\n\n'
        '#if defined(__GNUC__)\n#define LTS_ALIGNED __attribute__((aligned(64)))\n'
        '#else\n#define LTS_ALIGNED\n#endif\n\n'
    )
    with open(os.path.join(folder, f'{name}.c'), 'w', encoding='utf-8') as file:
        file.write(text + c_values.Structure(kind, values).source(name))


def write(folder: str, name: str, values: dict) -> None:
    """Writes the project into a folder that exists and is empty.

    Args:
      name: of `symbol`.
      values: of `model_data.values` or `soil_data.values`.
    """
    src, include, examples = (os.path.join(folder, part) for part in ('src', 'include', 'examples'))
    for part in (src, include, examples):
        os.makedirs(part)
    write_sources(src, name, values, include)
    for target, (of_subspace, of_field) in _TEMPLATES.items():
        template = of_field if is_soil(values) else of_subspace
        write_template(template, os.path.join(folder, target), words(name, values))


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
