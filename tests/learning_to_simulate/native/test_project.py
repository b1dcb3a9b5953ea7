"""The exported C project: built by CMake and without it, used from C++, two models in a program."""

import ctypes
import os
import re
import shutil
import subprocess
import sys
import tempfile
import types

import numpy as np
import pytest

from learning_to_simulate import checkpoints
from learning_to_simulate.export import __main__ as export_command
from learning_to_simulate.native import (
    agreement,
    exporting,
    fmu,
    library,
    model_data,
    project,
    starts,
)
from learning_to_simulate.native.binding import CSubspace
from tests.learning_to_simulate import models

pytestmark = pytest.mark.skipif(
    not any(map(library.shutil.which, ('cc', 'gcc', 'clang'))), reason='no C compiler'
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
    built = os.path.join(folder, 'small.so')
    library.compile_sources(built, folder)
    soils = CSubspace.open(built, 'lts_small'), CSubspace.of(model, group.n_rigid)
    for soil in soils:
        soil.reset(group.position[0, :6], group.context[0])
    for pose in group.position[0, 6:, : group.n_rigid]:
        a, b = (soil.step(pose) for soil in soils)
        np.testing.assert_array_equal(a.modes, b.modes)
        np.testing.assert_array_equal(a.force, b.force)
    assert soils[0].description.digest.decode() == values['digest']
    for path, symbol in (('none.so', 'lts_small'), (built, 'lts_other')):
        with pytest.raises(ValueError, match='no library of the model'):
            CSubspace.open(path, symbol)


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
    library.compile_sources(os.path.join(parts[0], 'both.so'), parts[0])
    soils = [CSubspace.open(os.path.join(parts[0], 'both.so'), n) for n in ('lts_one', 'lts_two')]
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
    monkeypatch.setattr(agreement, 'TOLERANCE', 0.0)
    with pytest.raises(ValueError, match='nothing was written'):
        exporting.export(path, data, out + '2', 'c')
    assert not os.path.exists(out + '2')
    monkeypatch.setenv('CC', 'no-such-compiler')
    description = exporting.export(path, data, out + '3', 'c')
    assert 'no C compiler' in exporting.summary(description, out)


@pytest.mark.parametrize('kind', ['c', 'fmu'])
def test_what_does_not_compile_is_not_kept(kind, tmp_path, monkeypatch):
    data, path, out = _saved(tmp_path)
    monkeypatch.setenv('CC', 'false')  # it is there, and it fails
    with pytest.raises(ValueError, match='false .* failed'):
        exporting.export(path, data, out, kind)
    assert not os.path.exists(out)


def test_an_fmu_whose_own_sources_do_not_compile_is_not_kept(tmp_path, monkeypatch):
    _, _, values = _small(tmp_path / 'data')
    monkeypatch.setenv('CC', 'false')
    with pytest.raises(library.CompileFailed):
        fmu.write(str(tmp_path / 'small.fmu'), 'lts_small', values)
    assert not os.path.exists(tmp_path / 'small.fmu')


def test_names_of_models_are_not_those_of_the_library():
    assert project.symbol('models/excavation/pcg') == 'lts_excavation_pcg'
    assert project.symbol('/a/Wheel 2/best-one') == 'lts_wheel_2_best_one'
    # Types, a function, and files; then names that leave no letter.
    taken = ('/model', '/field/model', '/field/frame', '/kernels', '/field/table')
    others = ('/a/\u571f/\u7802', '/a/\u7802/\u571f', '/--/..-', '/')
    names = [project.symbol(path) for path in taken + others]
    assert len(set(names)) == len(names)
    for path, name in zip(taken, names):
        assert re.fullmatch(path.replace('/', '_').join(['lts', '_[0-9a-f]{8}']), name)
    assert all(re.fullmatch('lts_[0-9a-f]{8}', name) for name in names[len(taken) :])


def test_a_model_in_a_folder_called_model_compiles(tmp_path):
    _, _, values = _small(tmp_path / 'data')
    name = project.symbol('/model')
    folder = _written(tmp_path / 'project', name, values)
    built = os.path.join(folder, 'model.so')
    library.compile_sources(built, folder, ('-std=c99', '-O1', '-fPIC', '-shared'))
    assert CSubspace.open(built, name).description.digest.decode() == values['digest']


def test_the_export_command_writes_c_and_refuses_what_is_not_for_it(tmp_path, capsys):
    data, path, out = _saved(tmp_path)
    values = types.SimpleNamespace(
        model_path=path, data_path=data, output_path=out, format='c', n_rigid=None,
        n_particles=None,
    )  # fmt: skip
    export_command.run(values)
    assert 'largest difference to TensorFlow' in capsys.readouterr().out
    assert os.path.exists(os.path.join(out, 'CMakeLists.txt'))
    values.n_particles, values.output_path = 2, out + '2'
    with pytest.raises(ValueError, match='--n_particles is not for --format=c'):
        export_command.run(values)
    assert not os.path.exists(out + '2')


def test_without_a_compiler_the_library_says_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setenv('CC', 'no-such-compiler')
    with pytest.raises(library.NoCompiler, match='no-such-compiler'):
        library.compiler()
    monkeypatch.delenv('CC')
    monkeypatch.setenv('PATH', str(tmp_path))
    monkeypatch.setattr(library.importlib.util, 'find_spec', lambda name: None)
    with pytest.raises(library.NoCompiler, match='none of cc, gcc and clang'):
        library.compiler()
    monkeypatch.setattr(library.importlib.util, 'find_spec', lambda name: name == 'ziglang')
    assert library.compiler() == [sys.executable, '-m', 'ziglang', 'cc']


def test_a_compiler_may_have_arguments(tmp_path, monkeypatch):
    plain = next(name for name in ('cc', 'gcc', 'clang') if shutil.which(name))
    (tmp_path / 'one.c').write_text('int lts_one(void) { return VALUE; }\n')
    monkeypatch.setenv('CC', f'env {plain} -DVALUE=7')
    assert library.compiler() == [shutil.which('env'), plain, '-DVALUE=7']
    library.compile_flat(str(tmp_path / 'one.so'), str(tmp_path), ['-shared', '-fPIC'])
    assert ctypes.CDLL(str(tmp_path / 'one.so')).lts_one() == 7
    monkeypatch.setenv('CC', ' ')
    assert library.compiler() == [shutil.which(plain)]


@pytest.fixture()
def own_cache(tmp_path, monkeypatch):
    """An empty cache of the library, and a process that has not loaded it yet."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    library.load.cache_clear()
    yield tmp_path / 'cache' / 'learning_to_simulate'
    library.load.cache_clear()


def test_a_library_that_cannot_be_loaded_leaves_the_steps_to_tensorflow(
    own_cache, tmp_path, monkeypatch
):
    """One of another processor, or in a home that runs no programs."""

    def of_another_machine(output, *_):
        with open(output, 'wb') as file:
            file.write(b'\x7fELF')

    monkeypatch.setattr(library, 'compile_sources', of_another_machine)
    with pytest.raises(library.NoCompiler, match='cannot be loaded'):
        library.load()
    model, (group,), _ = models.make(tmp_path / 'data')
    assert 'cannot be loaded' in models.stepper(model, group.n_rigid, kind='best').engine
    # A home that several kinds of machines share has a library for each.
    monkeypatch.setattr(library.platform, 'machine', lambda: 'another')
    with pytest.raises(library.NoCompiler):
        library.load()
    assert len(os.listdir(own_cache)) == 2


def test_libraries_of_one_process_leave_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    assert library.load_once().lts_error_text(-3)
    assert not os.listdir(tmp_path)


def test_a_home_that_cannot_be_written_is_no_obstacle(own_cache, tmp_path, monkeypatch):
    own_cache.parent.write_text('')
    (tmp_path / 'other').mkdir()
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path / 'other'))
    assert library.load().lts_error_text(-3)
    assert not os.listdir(tmp_path / 'other')
