"""Writes a model as a C project: sources, header, CMake and pkg-config files, examples."""

import os
import re
import shutil

from learning_to_simulate.export_c import c_header, c_values
from learning_to_simulate.scene import RigidMotion

VERSION = '1.0.0'  # of the C interface; its first number is LTS_ABI
_MOTIONS = [m.value for m in (RigidMotion.NONE, RigidMotion.PRESCRIBED, RigidMotion.DRIVEN,
                              RigidMotion.PREDICTED)]  # fmt: skip
# Template in native/ -> file of the project; @NAME@ is the model's.
_TEMPLATES = {
    'cmake/CMakeLists.txt.in': 'CMakeLists.txt',
    'cmake/README.md.in': 'README.md',
    'cmake/model.h.in': 'include/@NAME@.h',
    'examples/example.cpp.in': 'examples/example.cpp',
    'examples/loop_1khz.c.in': 'examples/loop_1khz.c',
    'examples/ros2_node.cpp.in': 'examples/ros2_node.cpp',
}


def symbol(model_path: str) -> str:
    """Name of a model in C: `lts_` and the last two folders of its path."""
    parts = os.path.abspath(model_path).split(os.sep)[-2:]
    return 'lts_' + re.sub(r'\W+', '_', '_'.join(parts), flags=re.ASCII).strip('_').lower()


def write_sources(folder: str, name: str, values: dict) -> None:
    """The C files of a model and of the library, in one folder.

    Args:
      folder: exists.
      name: of `symbol`.
      values: of `model_data.values`.
    """
    for part in sorted(os.listdir(os.path.join(c_header.NATIVE, 'src'))):
        copy(f'src/{part}', folder)
    with open(os.path.join(folder, f'{name}.c'), 'w', encoding='utf-8') as file:
        file.write(model_source(name, values))


def model_source(name: str, values: dict) -> str:
    """The generated C file: weights, ranges, starts and subspace as constants."""
    return (
        f'/* Generated from a trained model; digest {values["digest"]}. */\n'
        f'#include "{name}.h"\n#include "lts_model.h"\n\n'
        '#if defined(__GNUC__)\n#define LTS_ALIGNED __attribute__((aligned(64)))\n'
        '#else\n#define LTS_ALIGNED\n#endif\n\n'
        + c_values.Source().define('lts_model', name, values)
    )


def write(folder: str, name: str, values: dict) -> None:
    """Writes the project.

    Args:
      folder: exists and is empty.
      name: of `symbol`.
      values: of `model_data.values`.
    """
    for part in ('include', 'src', 'examples'):
        os.makedirs(os.path.join(folder, part))
    copy('include/lts.h', os.path.join(folder, 'include'))
    write_sources(os.path.join(folder, 'src'), name, values)
    words = {
        'NAME': name,
        'GUARD': f'{name.upper()}_H',
        'VERSION': VERSION,
        'DIGEST': values['digest'],
        'SCENE': values['name'],
        'RIGID': values['n_rigid'],
        'MOTION': _MOTIONS[values['motion']],
        'MODES': values['n_modes'],
        'SOIL': values.get('n_soil', 0),
        'STARTS': values['n_start'],
        'CONTEXT': values['context_names'].replace(',', ', ') or 'none',
        'DT': f'{values["dt"]:.6g}',
        'RATE': f'{1 / values["dt"]:.4g}',
    }
    for template, target in _TEMPLATES.items():
        write_template(template, os.path.join(folder, target.replace('@NAME@', name)), words)


def copy(part: str, folder: str) -> None:
    """Copies a file of native/ into a folder."""
    shutil.copy(os.path.join(c_header.NATIVE, part), folder)


def write_template(template: str, target: str, words: dict) -> None:
    """Writes a file of native/ with each @WORD@ replaced.

    Raises:
      KeyError: the template has a word that is not given.
    """
    with open(os.path.join(c_header.NATIVE, template), encoding='utf-8') as file:
        text = re.sub(r'@([A-Z_]+)@', lambda match: str(words[match[1]]), file.read())
    with open(target, 'w', encoding='utf-8') as file:
        file.write(text)
