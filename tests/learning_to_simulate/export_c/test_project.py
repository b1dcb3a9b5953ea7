"""The exported C project: built by CMake and without it, used from C++, two models in a program."""

import os
import shutil
import subprocess
import sys
import types

import numpy as np
import pytest

from learning_to_simulate import checkpoints
from learning_to_simulate.export import __main__ as export_command
from learning_to_simulate.export_c import (
    c_library,
    c_stepper,
    comparing,
    exporting,
    model_data,
    project,
    starts,
)
from learning_to_simulate.export_c.c_soil import CSoil
from tests.learning_to_simulate import models

pytestmark = pytest.mark.skipif(
    not any(map(c_library.shutil.which, ('cc', 'gcc', 'clang'))), reason='no C compiler'
)


def _small(folder, **case):
    model, (group, *_), metadata = models.make(folder, **case)
    found = starts.read(str(folder), model.simulator.config, group.n_rigid)
    return model, group, model_data.values(model, group.n_rigid, starts=found)


def _saved(folder):
    """Folders of a dataset, of a model of it, and one that is not there."""
    data, path, out = (str(folder / name) for name in ('data', 'model', 'out'))
    model, (group,), _ = models.make(data)
    os.makedirs(path)
    checkpoints.save_config(path, model, group.n_rigid, {})
    checkpoints.save_weights(path, model.simulator)
    return data, path, out


def _written(folder, name, values):
    os.makedirs(folder)
    project.write(str(folder), name, values)
    return str(folder)


def _run(command, **options):
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_generated_constants_give_the_same_bits_as_those_of_python(tmp_path):
    model, group, values = _small(tmp_path / 'data', motion='driven', context=True)
    folder = _written(tmp_path / 'project', 'lts_small', values)
    library = os.path.join(folder, 'small.so')
    c_library.compile_sources(library, folder)
    soils = CSoil.open(library, 'lts_small'), c_stepper.CStepper(model, group.n_rigid)
    for soil in soils:
        soil.reset(group.position[0, :6], group.context[0])
    for pose in group.position[0, 6:, : group.n_rigid]:
        a, b = (soil.step(pose) for soil in soils)
        np.testing.assert_array_equal(a.modes, b.modes)
        np.testing.assert_array_equal(a.force, b.force)
    assert soils[0].digest == values['digest']
    for path, symbol in (('none.so', 'lts_small'), (library, 'lts_other')):
        with pytest.raises(ValueError, match='no library of the model'):
            CSoil.open(path, symbol)


@pytest.mark.skipif(not shutil.which('cmake'), reason='no CMake')
def test_cmake_builds_installs_and_is_found(tmp_path):
    _, _, values = _small(tmp_path / 'data')
    folder, build = _written(tmp_path / 'project', 'lts_small', values), str(tmp_path / 'build')
    strict = '-Wall -Wextra -Wconversion -Wno-sign-conversion -pedantic -Werror'
    flags = [f'-DCMAKE_C_FLAGS={strict}', f'-DCMAKE_CXX_FLAGS={strict}']
    _run(['cmake', '-S', folder, '-B', build, *flags])
    _run(['cmake', '--build', build])
    printed = _run([os.path.join(build, 'example'), '30'])
    assert printed.count('force') == 3
    assert '60 forces' in _run([os.path.join(build, 'loop_1khz')])
    prefix = str(tmp_path / 'installed')
    _run(['cmake', '--install', build, '--prefix', prefix])
    user = tmp_path / 'user'
    user.mkdir()
    (user / 'main.c').write_text(
        '#include "lts_small.h"\nint main(void) { return lts_size(&lts_small) == 0; }\n'
    )
    (user / 'CMakeLists.txt').write_text(
        'cmake_minimum_required(VERSION 3.16)\nproject(user C)\n'
        'find_package(lts_small 1.0 REQUIRED)\nadd_executable(main main.c)\n'
        'target_link_libraries(main lts_small::shared)\n'
    )
    _run(['cmake', '-S', str(user), '-B', str(user / 'b'), f'-DCMAKE_PREFIX_PATH={prefix}'])
    _run(['cmake', '--build', str(user / 'b')])
    _run([str(user / 'b' / 'main')])
    with open(os.path.join(build, 'lts_small.pc'), encoding='utf-8') as file:
        assert '-llts_small' in file.read()


def test_two_models_live_in_one_program(tmp_path):
    parts = [
        _written(tmp_path / name, name, _small(tmp_path / f'data_{name}', motion=motion)[2])
        for name, motion in (('lts_one', 'prescribed'), ('lts_two', 'driven'))
    ]
    shutil.copy(os.path.join(parts[1], 'src', 'lts_two.c'), os.path.join(parts[0], 'src'))
    shutil.copy(os.path.join(parts[1], 'include', 'lts_two.h'), os.path.join(parts[0], 'include'))
    c_library.compile_sources(os.path.join(parts[0], 'both.so'), parts[0])
    soils = [CSoil.open(os.path.join(parts[0], 'both.so'), n) for n in ('lts_one', 'lts_two')]
    for soil in soils:
        soil.start()
    with pytest.raises(ValueError, match='saved state'):
        soils[0].load_state(soils[1].save() + bytes(10_000))


def test_export_command_compares_and_refuses(tmp_path, monkeypatch):
    data, path, out = _saved(tmp_path)
    description = exporting.export(path, data, out, 'c')
    assert description['compared']['relative_difference']['force'] < 1e-5
    assert 'wrote' in exporting.summary(description, out)
    assert os.path.exists(os.path.join(out, 'CMakeLists.txt'))
    with pytest.raises(ValueError, match='not empty'):
        exporting.export(path, data, out, 'c')
    with pytest.raises(FileNotFoundError, match='holds no model'):
        exporting.export(str(tmp_path / 'none'), data, out + '2', 'c')
    monkeypatch.setattr(comparing, 'TOLERANCE', 0.0)
    with pytest.raises(ValueError, match='nothing was written'):
        exporting.export(path, data, out + '2', 'c')
    assert not os.path.exists(out + '2')
    monkeypatch.setenv('CC', 'no-such-compiler')
    description = exporting.export(path, data, out + '3', 'c')
    assert 'no C compiler' in exporting.summary(description, out)


def test_the_export_command_writes_c_and_refuses_what_is_not_for_it(tmp_path, capsys):
    data, path, out = _saved(tmp_path)
    values = types.SimpleNamespace(
        model_path=path, data_path=data, output_path=out, format='c', n_rigid=None, members=None,
        n_particles=None,
    )  # fmt: skip
    export_command.run(values)
    assert 'largest difference to TensorFlow' in capsys.readouterr().out
    assert os.path.exists(os.path.join(out, 'CMakeLists.txt'))
    values.members, values.output_path = 2, out + '2'
    with pytest.raises(ValueError, match='--members=2 is not for --format=c'):
        export_command.run(values)
    assert not os.path.exists(out + '2')
    # Its older name, for one more release.
    older = [sys.executable, '-m', 'learning_to_simulate.export_c.exporting']
    given = [f'--model_path={tmp_path}/none', f'--data_path={data}', f'--output_path={out}2']
    done = subprocess.run([*older, *given], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and 'none: holds no model' in done.stderr


def test_without_a_compiler_the_library_says_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setenv('CC', 'no-such-compiler')
    with pytest.raises(c_library.NoCompiler, match='no-such-compiler'):
        c_library.compiler()
    monkeypatch.delenv('CC')
    monkeypatch.setenv('PATH', str(tmp_path))
    with pytest.raises(c_library.NoCompiler, match='none of cc, gcc and clang'):
        c_library.compiler()


def test_a_home_that_cannot_be_written_is_no_obstacle(tmp_path, monkeypatch):
    blocked = tmp_path / 'file'
    blocked.write_text('')
    monkeypatch.setenv('XDG_CACHE_HOME', str(blocked))
    c_library.load.cache_clear()
    try:
        assert c_library.load().lts_error_text(-3)
    finally:
        c_library.load.cache_clear()
