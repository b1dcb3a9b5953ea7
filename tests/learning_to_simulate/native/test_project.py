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

from learning_to_simulate.export import __main__ as export_command
from learning_to_simulate.export import exporting
from learning_to_simulate.native import exporting as c_exporting
from learning_to_simulate.native import library, project
from learning_to_simulate.native.binding import CSubspace, Loaded
from tests.learning_to_simulate import models
from tests.learning_to_simulate.native import worlds

pytestmark = worlds.needs_c
# Path of a model whose name the library has itself.
TAKEN = '/model'


def _run(command, **options):
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def opened(path, symbol):
    return CSubspace(Loaded.open(path, symbol))


@pytest.fixture(scope='module')
def small(tmp_path_factory):
    """C values of a small model."""
    return worlds.graph(tmp_path_factory.mktemp('small')).values


@pytest.fixture(scope='module')
def saved(tmp_path_factory):
    """Folders of a model and of its dataset."""
    return models.saved(tmp_path_factory.mktemp('saved'), with_subspace=False)


def test_two_models_in_one_library_give_the_same_bits_as_those_of_python(small, tmp_path):
    """One of them has a name that the library has, too."""
    graph = worlds.graph(tmp_path / 'data', motion='driven', context=True)
    model, group, name = graph.model, graph.group, project.symbol(TAKEN)
    folder = worlds.written(tmp_path / name, name, graph.values)
    other = worlds.written(tmp_path / 'two', 'lts_two', small)
    shutil.copy(f'{other}/src/lts_two.c', f'{folder}/src')
    shutil.copy(f'{other}/include/lts_two.h', f'{folder}/include')
    built = os.path.join(folder, 'both.so')
    library.compile_sources(built, *library.parts_of(folder))
    soils = opened(built, name), CSubspace.of(model, group.n_rigid)
    for soil in soils:
        soil.reset(group.position[0, :6], group.context[0])
    for pose in group.position[0, 6:, : group.n_rigid]:
        a, b = (soil.step(pose) for soil in soils)
        np.testing.assert_array_equal(a.modes, b.modes)
        np.testing.assert_array_equal(a.force, b.force)
    assert soils[0].description.digest.decode() == graph.values['digest']
    two = worlds.started(opened(built, 'lts_two'))
    with pytest.raises(ValueError, match='saved state'):
        worlds.restored(soils[0], worlds.saved(two) + bytes(10_000))
    for path, symbol in (('none.so', 'lts_two'), (built, 'lts_other')):
        with pytest.raises(ValueError, match='no library of the model'):
            opened(path, symbol)


@pytest.mark.skipif(not shutil.which('cmake'), reason='no CMake')
def test_cmake_builds_installs_and_is_found(small, tmp_path):
    folder = worlds.written(tmp_path / 'project', 'lts_small', small)
    build, prefix, user = (tmp_path / name for name in ('build', 'installed', 'user'))
    strict = '-Wall -Wextra -Wconversion -Wno-sign-conversion -pedantic -Werror'
    flags = [f'-DCMAKE_{of}={strict}' for of in ('C_FLAGS', 'CXX_FLAGS')]
    flags += ['-DCMAKE_C_FLAGS_RELEASE=-O0']
    _run(['cmake', '-S', folder, '-B', build, *flags])
    _run(['cmake', '--build', build])
    assert _run([build / 'example', '30']).count('force') == 3
    assert '60 forces' in _run([build / 'loop_1khz'])
    _run(['cmake', '--install', build, '--prefix', prefix])
    user.mkdir()
    (user / 'main.c').write_text(
        '#include "lts_small.h"\nint main(void) { return lts_size(&lts_small) == 0; }\n'
    )
    (user / 'CMakeLists.txt').write_text(
        'cmake_minimum_required(VERSION 3.16)\nproject(user C)\n'
        'find_package(lts_small 1.0 REQUIRED)\nadd_executable(main main.c)\n'
        'target_link_libraries(main lts_small::shared)\n'
    )
    _run(['cmake', '-S', user, '-B', user / 'b', f'-DCMAKE_PREFIX_PATH={prefix}'])
    _run(['cmake', '--build', user / 'b'])
    _run([user / 'b' / 'main'])
    assert '-llts_small' in (build / 'lts_small.pc').read_text(encoding='utf-8')


def test_the_export_command_compares_and_refuses(saved, tmp_path, monkeypatch, capsys):
    out = str(tmp_path / 'out')
    values = types.SimpleNamespace(
        model_path=saved[0], data_path=saved[1], output_path=out, format='c', n_tools=None
    )  # fmt: skip
    export_command.run(values)
    assert 'largest difference to the source' in capsys.readouterr().out
    assert os.path.exists(os.path.join(out, 'CMakeLists.txt'))
    for change, error, message in (
        ({}, ValueError, 'not empty'),
        ({'model_path': str(tmp_path / 'none')}, FileNotFoundError, 'no folder with a config.json'),
    ):
        if change:
            values.output_path = out + '2'
        with pytest.raises(error, match=message):
            export_command.run(types.SimpleNamespace(**vars(values) | change))
    monkeypatch.setattr(c_exporting, 'TOLERANCE', 0.0)
    with pytest.raises(ValueError, match='differs from the model.*nothing was written'):
        exporting.export(*saved, out + '2', 'c')
    assert not os.path.exists(out + '2')


@pytest.mark.parametrize('kind', ['c', 'fmu'])
def test_without_a_compiler_nothing_is_compared_and_with_a_bad_one_nothing_is_written(
    saved, tmp_path, monkeypatch, kind
):
    out = str(tmp_path / 'out')
    if kind == 'fmu':
        saved = 'models/excavation/soil_field', 'datasets/excavation'
    monkeypatch.setenv('CC', 'none')
    description = exporting.export(*saved, out, kind)
    assert 'no C compiler' in exporting.summary(description, out)
    monkeypatch.setenv('CC', 'false')
    with pytest.raises(ValueError, match='false .* failed'):
        exporting.export(*saved, out + '2', kind)
    assert not os.path.exists(out + '2')


def test_names_of_models_are_not_those_of_the_library():
    assert project.symbol('models/excavation/pcg') == 'lts_excavation_pcg'
    assert project.symbol('/a/Wheel 2/best-one') == 'lts_wheel_2_best_one'
    # Types, a function, and files; then names that leave no letter.
    taken = (TAKEN, '/soil/model', '/soil/step', '/kernels', '/soil/table')
    others = ('/a/\u571f/\u7802', '/a/\u7802/\u571f', '/--/..-', '/')
    names = [project.symbol(path) for path in taken + others]
    assert len(set(names)) == len(names)
    for path, name in zip(taken, names):
        assert re.fullmatch(path.replace('/', '_').join(['lts', '_[0-9a-f]{8}']), name)
    assert all(re.fullmatch('lts_[0-9a-f]{8}', name) for name in names[len(taken) :])


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
    built = str(tmp_path / 'one.so')
    library.compile_sources(built, str(tmp_path), flags=['-shared', '-fPIC'])
    assert ctypes.CDLL(built).lts_one() == 7
    monkeypatch.setenv('CC', ' ')
    assert library.compiler() == [shutil.which(plain)]


@pytest.fixture()
def own_cache(tmp_path, monkeypatch):
    """An empty cache of the library, and a process that has not loaded it yet, whose compiler is
    quick: it copies the library that is there."""
    built = library.load()._name
    copied = lambda output, *_: shutil.copy(built, output)  # noqa: E731
    monkeypatch.setattr(library, 'compile_sources', copied)
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


def test_a_home_that_cannot_be_written_is_no_obstacle_and_no_file_is_left(
    own_cache, tmp_path, monkeypatch
):
    own_cache.parent.write_text('')
    (tmp_path / 'other').mkdir()
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path / 'other'))
    assert library.load()._name.startswith(str(tmp_path / 'other'))
    assert not os.listdir(tmp_path / 'other')
