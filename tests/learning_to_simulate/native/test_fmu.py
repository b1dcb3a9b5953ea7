"""The FMU by FMPy: valid, equal to the library, rolled back bit by bit, side by side."""

import os
import subprocess
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest

from learning_to_simulate.native import fmu, library
from learning_to_simulate.native.binding import CSubspace
from tests.learning_to_simulate.native import worlds

fmpy = pytest.importorskip('fmpy', reason='FMPy is not installed: pip install -e .[fmu]')
from fmpy import fmi2, validation  # noqa: E402
from fmpy.fmi1 import FMICallException  # noqa: E402

pytestmark = worlds.needs_c
CASES = {
    'prescribed': {},
    'driven': {'motion': 'driven', 'context': True},
    'predicted': {'motion': 'predicted', 'context': True},
}
PARTS = {'pos': 'xyz', 'rot': ('e0', 'e1', 'e2', 'e3'), 'lin_vel': 'xyz', 'ang_vel': 'xyz'}


def _write(folder, **case):
    """(path of the FMU, `worlds.Graph`)."""
    made = worlds.graph(folder / 'data', **case)
    path = str(folder / 'soil.fmu')
    fmu.write(path, 'lts_small', made.values)
    return path, made


@pytest.fixture(scope='module')
def shared(tmp_path_factory):
    """The FMU of a driven body."""
    return _write(tmp_path_factory.mktemp('fmu'), **CASES['driven'])


class _Slave:
    """An instance of an FMU with its variables by name."""

    def __init__(self, path, folder, name='one', **inputs):
        description = fmpy.read_model_description(path)
        self.vr = {v.name: v.valueReference for v in description.modelVariables}
        self.body, self.logged = _body(self.vr), []
        self.c = fmi2.FMU2Slave(
            guid=description.guid,
            unzipDirectory=fmpy.extract(path, unzipdir=str(folder)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(
            lambda env, name, status, category, message: self.logged.append(
                (category.decode(), message.decode())
            )
        )
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
        self.c.instantiate(callbacks=callbacks, loggingOn=True)
        self.c.setupExperiment(startTime=0.0)
        self.c.enterInitializationMode()
        self.set(**inputs)
        self.c.exitInitializationMode()
        self.time = 0.0

    def set(self, **parts):
        """Parts of the pose and twist of the body (`PARTS`), and other reals by name."""
        for part, values in parts.items():
            names = [f'{self.body}_state.{part}.{a}' for a in PARTS.get(part, ())] or [part]
            reference = [self.vr[n] for n in names]
            self.c.setReal(reference, [float(v) for v in np.atleast_1d(values)])

    def step(self, h):
        self.c.doStep(self.time, h)
        self.time += h

    def get(self, part):
        return np.array(self.c.getReal([self.vr[f'{self.body}_load.{part}.{a}'] for a in 'xyz']))

    def free(self):
        self.c.terminate()
        self.c.freeInstance()


def _body(names):
    return 'tool' if 'tool_state.pos.x' in names else 'wheel'


@pytest.mark.parametrize('case', CASES.values(), ids=CASES)
def test_is_valid_and_simulates(case, tmp_path):
    path, *_ = _write(tmp_path, **case)
    assert validation.validate_fmu(path) == []
    result = fmpy.simulate_fmu(path, stop_time=0.2, output_interval=1 / 60)
    force = [n for n in result.dtype.names if '.force.' in n]
    assert len(force) == 3 and all(np.isfinite(result[n]).all() for n in force)
    assert np.abs(result[force[0]][2:]).max() > 0


def _pose(start, twist, t):
    """[7] of a body that keeps its twist [6], turning about z."""
    half = 0.5 * t * twist[5]
    return np.array([*(start + t * twist[:3]), np.cos(half), 0.0, 0.0, np.sin(half)])


def test_equals_the_stepper_for_every_step_of_the_master(shared, tmp_path):
    """Frame by frame, in single milliseconds and in steps of three frames: frames stay whole."""
    path, (model, group, starts, values) = shared
    dt, twist = model.simulator.scene.dt, np.array([-0.06, -0.02, 0.0, 0.0, 0.0, 0.4])
    first = values['starts'][0]['points'].mean(axis=0)
    stepper = CSubspace.of(model, group.n_rigid, starts=starts)
    stepper.start(0, _pose(first, twist, 0.0), twist, values['starts'][0]['context'])
    expected = np.array([stepper.step_at(_pose(first, twist, k * dt)).force for k in range(1, 19)])
    for h in (dt, dt / 16, 3 * dt):
        slave = _Slave(path, tmp_path / f'h{h:.4f}', lin_vel=twist[:3], ang_vel=twist[3:])
        forces = []
        for k in range(round(18 * dt / h)):
            pose = _pose(first, twist, k * h)
            slave.set(pos=pose[:3], rot=pose[3:])
            slave.step(h)
            done = (k + 1) * h / dt
            if abs(done - round(done)) < 1e-6:
                forces.append(slave.get('force'))
        slave.free()
        every = max(1, round(h / dt))
        np.testing.assert_allclose(forces, expected[every - 1 :: every], rtol=1e-4, atol=1e-3)


def test_rollback_serialised_states_and_two_instances_are_bit_exact(shared, tmp_path):
    path = shared[0]
    slow, fast = ([v, 0, 0] for v in (-0.02, -0.06))
    one, other = (_Slave(path, tmp_path / n, n, lin_vel=fast) for n in ('a', 'b'))
    place = one.get('point')

    def go(slave, time, n, lin_vel, h=0.011):
        """Forces of n steps from a time on."""
        slave.time, forces = time, []
        for _ in range(n):
            slave.set(pos=place + slave.time * np.array(lin_vel), lin_vel=lin_vel)
            slave.step(h)
            forces.append(slave.get('force'))
        return np.array(forces)

    go(one, 0.0, 5, fast)
    state, time = one.c.getFMUstate(), one.time
    saved = one.c.serializeFMUstate(state)
    first = go(one, time, 7, fast)
    go(other, 0.0, 5, slow)  # Another instance in between changes nothing.
    theirs = other.c.deSerializeFMUstate(saved)
    for slave, at in ((one, state), (other, theirs)):
        slave.c.setFMUstate(at)
        np.testing.assert_array_equal(go(slave, time, 7, fast), first)
        slave.c.freeFMUstate(at)
        slave.free()


def test_status_is_told_and_bad_input_is_refused(shared, tmp_path):
    path, made = shared
    slave = _Slave(path, tmp_path / 'x')
    ok, outside = (slave.vr[f'status.{n}'] for n in ('ok', 'extrapolating'))
    slave.set(pos=made.values['starts'][0]['points'].mean(axis=0) + [3.0, 0, 0])
    slave.step(made.model.simulator.scene.dt)
    assert slave.c.getBoolean([ok, outside]) == [False, True]
    assert {category for category, _ in slave.logged} == {'logStatusWarning'}
    texts = [text for _, text in slave.logged]
    assert any('pose lies outside' in t for t in texts)
    assert any('coordinate' in t and t.endswith('of training') for t in texts)
    for act in (
        lambda: slave.set(pos=[np.nan, 0, 0]),
        lambda: slave.set(step_size=0.1),
        lambda: slave.set(gravity=9.0),
        lambda: slave.c.setReal([999], [0.0]),
        lambda: slave.c.doStep(slave.time, -1.0),
        lambda: (slave.set(rot=[0, 0, 0, 0]), slave.step(0.1)),
    ):
        with pytest.raises(FMICallException):
            act()
    slave.free()
    with pytest.raises(ValueError, match='needs a body'):
        fmu.write(str(tmp_path / 'y.fmu'), 'lts_small', made.values | {'n_start': 0})


def test_sources_alone_build_the_binary(shared, tmp_path):
    """As an importer on another machine does: one folder, no network, no flags."""
    with zipfile.ZipFile(shared[0]) as archive:
        archive.extractall(tmp_path)
        names = archive.namelist()
    assert 'binaries/linux64/lts_small.so' in names or os.name != 'posix'
    root = ElementTree.parse(tmp_path / 'modelDescription.xml')
    listed = [file.get('name') for file in root.iter('File')]
    sources = [str(tmp_path / 'sources' / name) for name in listed]
    built = str(tmp_path / 'again.so')
    subprocess.run(
        [*library.compiler(), '-O1', '-fPIC', '-shared', f'-I{tmp_path}/sources', *sources,
         '-o', built, '-lm'], check=True,
    )  # fmt: skip
    symbols = subprocess.run(['nm', '-D', built], capture_output=True, text=True).stdout
    assert sum(' T fmi2' in line for line in symbols.splitlines()) == 34
