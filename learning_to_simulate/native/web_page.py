"""Writes a page that needs no server: one HTML file with a soil field as WebAssembly inside.

The compiler comes with the package `ziglang` (extra `page`). The page loads nothing. It draws by
WebGL without a library: a ground, a tool and grains are all, and a library such as three.js comes
by npm, so that no page could be written without a network.

Examples:
  lts live                                  # writes the page of the blade and opens it
  lts live --model_path=excavation --output_path=blade.html
"""

import base64
import gzip
import importlib.util
import json
import os
import pathlib
import tempfile
import webbrowser

import numpy as np
from absl import flags

from learning_to_simulate import command
from learning_to_simulate.native import library
from pca_tools import files

TARGET = ('--target=wasm32-wasi', '-std=c99', '-O3', '-msimd128', '-mexec-model=reactor',
          '-Wl,--no-entry', '-Wl,--strip-all')  # fmt: skip
MISSING = 'pip install ziglang, or learning_to_simulate_soil[page]'
MAX_BYTES = 3_000_000
_PARTS = {'STYLE': 'style.css', 'SCENE': 'scene.js', 'PLOT': 'plot.js', 'MACHINE': 'machine.js',
          'PAGE': 'page.js'}  # fmt: skip


def is_available() -> bool:
    return importlib.util.find_spec('ziglang') is not None


def compile_model(name: str, values: dict) -> bytes:
    """The WebAssembly of a soil field, of `project.symbol` and `soil_data.values`; ValueError where
    no compiler is there, or as `library.compile_sources`."""
    if not is_available():
        raise ValueError(f'there is no compiler for WebAssembly, which a page needs: {MISSING}')
    from learning_to_simulate.native import project  # loads TensorFlow

    with tempfile.TemporaryDirectory() as folder:
        project.write_sources(folder, name, values)
        project.copy('page/page.c', folder)
        wasm = os.path.join(folder, 'soil.wasm')
        flags = *TARGET, f'-DLTS_MODEL={name}'
        library.compile_sources(wasm, folder, flags=flags, command=library.ZIG)
        return pathlib.Path(wasm).read_bytes()


def ghost(run) -> dict:
    """A recorded `soil_field.runs.Run` as the page reads it: all numbers as text of few digits."""
    before, tool = run.before(), run.tool
    steps = np.rint((run.heights - before.heights) / 1e-4).clip(-32768, 32767).astype('<i2')
    bed = np.rint(before.heights / 1e-5).astype('<i4')
    return {
        'name': f'{run.kind} {run.case}',
        'dt': run.dt,
        'stride': run.stride,
        'pose': np.round(run.pose, 7).tolist(),
        'force': np.round(run.force, 2).tolist(),
        'torque': np.round(run.torque, 3).tolist(),
        'n': list(before.shape),
        'corner': list(map(float, run.corner)),
        'cell': list(map(float, run.cell)),
        'bed': _packed(bed),
        'heightSteps': _packed(np.diff(steps, axis=0, prepend=0).astype('<i2')),
        'tool': library.tool_numbers(tool),
        'soil': [run.soil.friction_angle_deg, run.soil.density, run.soil.gravity],
    }


def write(path: str, name: str, field, run=None) -> None:
    """Writes the page as one HTML file; ValueError as of `compile_model`, or for more than 3 MB.

    Args:
      name: of `project.symbol`.
      field: `SoilField`.
      run: `soil_field.runs.Run` that is played beside; None for none.
    """
    from learning_to_simulate.native import project, soil_data  # load TensorFlow
    from learning_to_simulate.soil_field import field as soil_field

    values = soil_data.values(field)
    kind = field.networks.tool
    config = {
        'kind': kind.name,
        'model': name.removeprefix('lts_').replace('_', ' '),
        'digest': values['digest'][:12],
        'tool': library.tool_numbers(kind()),
        'words': {name: soil_field.WORDS[name] for name in field.judged_names},
        'ghost': None if run is None else ghost(run),
    }
    words = {
        part: pathlib.Path(library.SOURCES, 'page', file).read_text(encoding='utf-8')
        for part, file in _PARTS.items()
    }
    words['TITLE'] = f'Soil under a {kind.name}'
    # In a script of HTML no text may close it.
    words['CONFIG'] = json.dumps(config, separators=(',', ':')).replace('<', '\\u003c')
    words['WASM'] = _packed(np.frombuffer(compile_model(name, values), np.uint8))
    project.write_template('page/page.html.in', path, words)
    if (size := os.path.getsize(path)) > MAX_BYTES:
        os.unlink(path)
        raise ValueError(f'the page has {size} bytes, more than {MAX_BYTES}: fewer members, or '
                         f'networks with fewer hidden units, make a smaller one')  # fmt: skip


def export(model_path: str, output_path: str, data_path: str | None = None) -> None:
    """Writes the page of a trained soil field, whole or not at all; the first test run of a dataset
    (None: none) with the usual soil is played beside.

    Raises:
      ValueError, FileNotFoundError: a model that is no soil field, no compiler, no such dataset.
    """
    folder = os.path.dirname(os.path.abspath(output_path))
    command.writable_folder(folder)
    command.import_tensorflow()
    from learning_to_simulate import registry, shipped
    from learning_to_simulate.native import project
    from learning_to_simulate.soil_field import runs
    from learning_to_simulate.soil_field.field import SoilField

    path = shipped.find(model_path, 'models')
    field = registry.of_folder(path).load_code().load(path)
    if not isinstance(field, SoilField):
        raise ValueError(f'{path}: a page takes a soil field')
    run = None
    if data_path:
        test = runs.read(shipped.find(data_path.split(',')[0], 'datasets'), 'test')
        kind = field.networks.tool.name
        run = next((r for r in test if r.tool.name == kind and np.ptp(r.pose[:, 0]) > 0.2),
                   next((r for r in test if r.tool.name == kind), None))  # fmt: skip
        if run is None:
            raise ValueError(f'{data_path}: no test run of a {kind}')
    os.makedirs(folder, exist_ok=True)
    files.write_atomically(output_path, lambda part: write(part, project.symbol(path), field, run))
    print(f'wrote {output_path} ({os.path.getsize(output_path) / 1e6:.2g} MB)')


def define_flags() -> None:
    flags.DEFINE_string('model_path', 'excavation', 'Soil field: a path or a shipped name.')
    flags.DEFINE_string('data_path', None, 'Dataset with a run of the solver to play beside.')
    flags.DEFINE_string('output_path', None, 'HTML file to write; nothing is opened then.')


def run(values) -> None:
    path = values.output_path
    if path is None:
        path = os.path.join(tempfile.mkdtemp(prefix='lts-'), 'page.html')
    export(values.model_path, path, values.data_path)
    if values.output_path is None:
        webbrowser.open(pathlib.Path(path).resolve().as_uri())


def _packed(array):
    """Bytes as text that a browser unpacks by itself."""
    return base64.b64encode(gzip.compress(array.tobytes(), 9, mtime=0)).decode('ascii')


if __name__ == '__main__':
    define_flags()
    command.start(run)
