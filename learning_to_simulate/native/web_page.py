"""Writes a page that needs no server: one HTML file with the C library as WebAssembly inside.

The compiler and its C library come with the package `ziglang` (extra `page`). The kernels' vectors
of four become those of WebAssembly.
"""

import base64
import glob
import importlib.util
import json
import os
import subprocess
import sys
import tempfile

import numpy as np

from learning_to_simulate import command
from learning_to_simulate.native import library, project
from pca_tools import files

TARGET = ('--target=wasm32-wasi', '-O3', '-msimd128', '-mexec-model=reactor', '-Wl,--no-entry',
          '-Wl,--strip-all')  # fmt: skip
MISSING = 'pip install ziglang, or learning_to_simulate_soil[page]'


def is_available() -> bool:
    """Whether the compiler is there."""
    return importlib.util.find_spec('ziglang') is not None


def compile_model(name: str, values: dict) -> bytes:
    """The WebAssembly of a model.

    Args:
      name: of `project.symbol`.
      values: of `model_data.values`.

    Raises:
      ValueError: no compiler for it, or one that does not compile it; the message has its words.
    """
    if not is_available():
        raise ValueError(f'there is no compiler for WebAssembly, which a page needs: {MISSING}')
    if not values.get('n_soil'):
        raise ValueError('a page draws particles: the model has no subspace')
    with tempfile.TemporaryDirectory() as folder:
        project.write_sources(folder, name, values)
        project.copy('page/page.c', folder)
        for part in os.listdir(os.path.join(library.SOURCES, 'include')):
            project.copy(f'include/{part}', folder)
        with open(os.path.join(folder, f'{name}.h'), 'w', encoding='utf-8') as file:
            file.write(f'#include "lts.h"\nextern const lts_model {name};\n')
        wasm = os.path.join(folder, 'soil.wasm')
        done = subprocess.run(
            [sys.executable, '-m', 'ziglang', 'cc', *TARGET, f'-DLTS_MODEL={name}',
             f'-DLTS_SOIL={values["n_soil"]}', f'-I{folder}',
             *sorted(glob.glob(f'{folder}/*.c')), '-o', wasm],
            capture_output=True, text=True,
        )  # fmt: skip
        if done.returncode:
            raise ValueError(f'the model cannot be compiled for a page: {done.stderr}')
        with open(wasm, 'rb') as file:
            return file.read()


def settings(session) -> dict:
    """What the page has to know beside the model.

    Args:
      session: `live_page.session.Session` of the model, newly started.

    Raises:
      ValueError: a body whose motion is not given has nothing to steer.
    """
    from learning_to_simulate.live_page import drawing

    steering, scene = session.steering, session.scene
    if steering is None:
        raise ValueError('the motion of the body is predicted: there is nothing to steer on a page')
    up, body, rest = scene.up_axis, session.body(), session.rest
    across = 3 - up
    starts, (hull, faces) = session.model.starts, drawing.hull(body)
    low, high = rest.min(axis=0), rest.max(axis=0)
    half = session.pose_of((0.0, 0.0, np.pi))  # its quaternion has the sign of a turn
    travel = session.travel()
    return {
        'n_soil': len(rest), 'dt': scene.dt, 'up': up, 'across': across,
        'sign': float(np.sign(half[4 + across])), 'driven': hasattr(steering, 'radius'),
        'sliders': [{'name': n, **vars(s)} for n, s in steering.sliders.items()],
        'radius': getattr(steering, 'radius', None), 'forwards': steering.forwards,
        'fastest': steering.fastest.tolist(), 'level': session.level,
        'start': session.plane.tolist(), 'low': travel[0], 'high': travel[1],
        'lateral': float(session.moment.pose[across]),
        # The C library names the middle of the nodes, and their attitude at the start.
        'reference': starts.body[session.start][starts.kept[session.start]].mean(axis=0).tolist(),
        'plan': body[:, [0, up]].tolist(), 'hull': hull.tolist(), 'faces': faces.tolist(),
        'box': [low.tolist(), high.tolist()],
        'spacing': float((np.prod(high - low) / len(rest)) ** (1 / 3)),
        'force_limit': starts.force_limit or 100.0,
    }  # fmt: skip


def write(path: str, name: str, values: dict, session) -> None:
    """Writes the page.

    Args:
      path: of the HTML file.
      name, values: as of `compile_model`, whose errors this raises.
      session: as of `settings`.
    """
    from learning_to_simulate import checkpoints  # loads TensorFlow

    weights = os.path.join(session.model.path, checkpoints.WEIGHTS_FILE)
    words = {
        'TITLE': values['name'],
        # Of the model, and not of the C values: these are products, which another processor rounds
        # differently.
        'DIGEST': files.sha256_of_file(weights)[:12],
        'CONFIG': json.dumps(settings(session), separators=(',', ':')),
        'WASM': base64.b64encode(compile_model(name, values)).decode('ascii'),
    }
    template = 'page/page.html.in'
    files.write_atomically(path, lambda part: project.write_template(template, part, words))


def run(values) -> None:
    """Runs `lts export --format=page` with its flags.

    Raises:
      ValueError: no compiler for WebAssembly, or a model that has no page.
    """
    folder = os.path.dirname(os.path.abspath(values.output_path))
    command.writable_folder(folder)
    if not is_available():
        raise ValueError(f'there is no compiler for WebAssembly, which a page needs: {MISSING}')
    command.import_tensorflow()
    from learning_to_simulate import api, shipped
    from learning_to_simulate.live_page import recorded
    from learning_to_simulate.live_page.session import Session
    from learning_to_simulate.native import agreement

    path = shipped.find(values.model_path, 'models')
    model, opened = api.load(path), agreement.Opened.of(path)
    if opened.field is not None:
        raise ValueError(f'{path}: a page without a server takes models in the subspace')
    os.makedirs(folder, exist_ok=True)
    session = Session(model, recorded.of_model(model, values.data_path))
    write(values.output_path, project.symbol(path), opened.values(), session)
    print(f'wrote {values.output_path} ({os.path.getsize(values.output_path) / 1e6:.2g} MB)')
