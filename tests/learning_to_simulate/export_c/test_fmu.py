"""The FMU by FMPy: valid, equal to the project's rollout, rolled back bit by bit, side by side."""

import os
import subprocess
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest

from learning_to_simulate.export_c import (
    c_library,
    c_stepper,
    field_data,
    fmu,
    model_data,
    starts,
)
from tests.learning_to_simulate import models

fmpy = pytest.importorskip('fmpy', reason='FMPy is not installed: pip install -e .[fmu]')
from fmpy import fmi2, validation  # noqa: E402
from fmpy.fmi1 import FMICallException  # noqa: E402

pytestmark = pytest.mark.skipif(
    not any(map(c_library.shutil.which, ('cc', 'gcc', 'clang'))), reason='no C compiler'
)
CASES = {
    'prescribed': {},
    'driven': {'motion': 'driven', 'context': True},
    'predicted': {'motion': 'predicted', 'context': True},
}


def _write(folder, **case):
    """(path of the FMU, model, starts, values)."""
    model, (group, *_), metadata = models.make(folder / 'data', **case)
    found = starts.read(str(folder / 'data'), model.simulator.config, group.n_rigid)
    values = model_data.values(model, group.n_rigid, starts=found)
    path = str(folder / 'soil.fmu')
    fmu.write(path, 'lts_small', values)
    return path, model, found, values


@pytest.fixture(scope='module')
def shared(tmp_path_factory):
    """The FMU of a driven body."""
    return _write(tmp_path_factory.mktemp('fmu'), **CASES['driven'])


def _body(path):
    names = [v.name for v in fmpy.read_model_description(path).modelVariables]
    return 'tool' if 'tool_state.pos.x' in names else 'wheel'


class _Slave:
    """An instance of an FMU with its variables by name."""

    def __init__(self, path, folder, name='one', **start):
        description = fmpy.read_model_description(path)
        self.vr = {v.name: v.valueReference for v in description.modelVariables}
        self.body, self.logged = _body(path), []
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
        self.set(**start)
        self.c.exitInitializationMode()
        self.time = 0.0

    def set(self, pos=None, rot=None, lin=None, ang=None, **others):
        for part, axes, values in (
            ('pos', 'xyz', pos), ('rot', ('e0', 'e1', 'e2', 'e3'), rot),
            ('lin_vel', 'xyz', lin), ('ang_vel', 'xyz', ang),
        ):  # fmt: skip
            if values is not None:
                names = [f'{self.body}_state.{part}.{a}' for a in axes]
                self.c.setReal([self.vr[n] for n in names], list(map(float, values)))
        for name, value in others.items():
            self.c.setReal([self.vr[name]], [float(value)])

    def step(self, h):
        self.c.doStep(self.time, h)
        self.time += h

    def get(self, part):
        return np.array(self.c.getReal([self.vr[f'{self.body}_load.{part}.{a}'] for a in 'xyz']))

    def free(self):
        self.c.terminate()
        self.c.freeInstance()


@pytest.mark.parametrize('case', CASES.values(), ids=CASES)
def test_is_valid_and_simulates(case, tmp_path):
    path, *_ = _write(tmp_path, **case)
    assert validation.validate_fmu(path) == []
    result = fmpy.simulate_fmu(path, stop_time=0.2, output_interval=1 / 60)
    force = [n for n in result.dtype.names if '.force.' in n]
    assert len(force) == 3 and all(np.isfinite(result[n]).all() for n in force)
    assert np.abs(result[force[0]][2:]).max() > 0


SHIPPED = [
    *(f'{s}/{n}' for s in ('excavation', 'wheel') for n in ('pcg', 'pcg_thesis', 'fcg_original')),
    'excavation_v2/swept_field',
    'wheel_v2/swept_field',
]


@pytest.mark.slow
@pytest.mark.parametrize('name', SHIPPED)
def test_shipped_models_are_valid_in_both_versions(name, tmp_path):
    path = os.path.join('models', name)
    if name.endswith('swept_field'):
        field, parts = field_data.read(path)
        values = field_data.values(field, **parts)
    else:
        data = os.path.join('datasets', os.path.dirname(name))
        model, n, subspace, found = starts.read_model(path, data)
        values = model_data.values(model, n, subspace, starts=found)
    for version in fmu.VERSIONS:
        written = str(tmp_path / f'soil{version}.fmu')
        fmu.write(written, 'lts_soil', values, version)
        assert validation.validate_fmu(written) == []
        result = fmpy.simulate_fmu(written, stop_time=0.1, output_interval=1 / 60)
        assert all(np.isfinite(result[n]).all() for n in result.dtype.names)


def _path(found, twist, dt, n_frame):
    """Poses [n_frame + 1, 7] of a body that keeps its twist (turning about z)."""
    t = dt * np.arange(n_frame + 1)
    centre = found['points'].mean(axis=0) + t[:, None] * twist[:3]
    half = 0.5 * t * twist[5]
    return np.c_[centre, np.cos(half), 0 * t, 0 * t, np.sin(half)]


@pytest.mark.parametrize('case', ['prescribed', 'driven'])
def test_equals_the_stepper_for_every_step_of_the_master(case, tmp_path):
    """Frame by frame, in single milliseconds and in steps of three frames: frames stay whole."""
    path, model, found, _ = _write(tmp_path, **CASES[case])
    dt, twist = model.simulator.scene.dt, np.array([-0.06, -0.02, 0.0, 0.0, 0.0, 0.4])
    poses = _path(found[0], twist, dt, 18)
    stepper = c_stepper.CStepper(model, len(found[0]['points']), starts=found)
    context = None if case == 'prescribed' else found[0]['context']
    stepper.start(0, poses[0], twist, context)
    expected = np.array([stepper.step_at(pose).force for pose in poses[1:]])
    for h in (dt, dt / 16, 3 * dt):
        slave = _Slave(path, tmp_path / f'h{h:.4f}', lin=twist[:3], ang=twist[3:])
        forces = []
        for k in range(round(18 * dt / h)):
            pose = _path(found[0], twist, h, k)[-1]
            slave.set(pos=pose[:3], rot=pose[3:])
            slave.step(h)
            done = (k + 1) * h / dt
            if abs(done - round(done)) < 1e-6:
                forces.append(slave.get('force'))
        slave.free()
        every = max(1, round(h / dt))
        np.testing.assert_allclose(forces, expected[every - 1 :: every], rtol=1e-4, atol=1e-3)


def test_rollback_and_serialised_states_are_bit_exact(shared, tmp_path):
    path, model, found, _ = shared
    one, other = (_Slave(path, tmp_path / n, n, lin=[-0.06, 0, 0]) for n in ('a', 'b'))
    dt = model.simulator.scene.dt
    for _ in range(5):
        one.step(0.7 * dt)
    state = one.c.getFMUstate()
    saved = one.c.serializeFMUstate(state)
    time = one.time

    def go(slave):
        slave.time = time
        for _ in range(7):
            slave.step(0.9 * dt)
        return slave.get('force')

    first = go(one)
    one.c.setFMUstate(state)
    np.testing.assert_array_equal(go(one), first)
    theirs = _restored(other, saved)
    np.testing.assert_array_equal(go(other), first)
    one.c.freeFMUstate(state)
    other.c.freeFMUstate(theirs)
    one.free()
    other.free()


def _restored(slave, saved):
    state = slave.c.deSerializeFMUstate(saved)
    slave.c.setFMUstate(state)
    return state


def test_two_instances_in_turns_do_not_touch_each_other(shared, tmp_path):
    path, model, *_ = shared
    dt = model.simulator.scene.dt
    motions = ([-0.06, 0, 0], [-0.02, 0, 0])

    def alone(motion, name):
        slave = _Slave(path, tmp_path / name, name, lin=motion)
        forces = []
        for _ in range(6):
            slave.step(dt)
            forces.append(slave.get('force'))
        slave.free()
        return forces

    expected = [alone(motion, f'alone{i}') for i, motion in enumerate(motions)]
    pair = [_Slave(path, tmp_path / f'p{i}', f'p{i}', lin=m) for i, m in enumerate(motions)]
    got = [[], []]
    for _ in range(6):
        for slave, forces in zip(pair, got):
            slave.step(dt)
            forces.append(slave.get('force'))
    for slave in pair:
        slave.free()
    np.testing.assert_array_equal(got, expected)


def test_status_is_told_and_bad_input_is_refused(shared, tmp_path):
    path, model, found, values = shared
    slave = _Slave(path, tmp_path / 'x')
    ok, outside = (slave.vr[f'status.{n}'] for n in ('ok', 'extrapolating'))
    slave.set(pos=found[0]['points'].mean(axis=0) + [3.0, 0, 0])
    slave.step(model.simulator.scene.dt)
    assert slave.c.getBoolean([ok, outside]) == [False, True]
    assert {category for category, _ in slave.logged} == {'logStatusWarning'}
    assert any('pose lies outside' in text for _, text in slave.logged)
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
        fmu.write(str(tmp_path / 'y.fmu'), 'lts_small', values | {'n_start': 0})


def test_sources_alone_build_the_binary(shared, tmp_path):
    """As an importer on another machine does: one folder, no network, no flags."""
    with zipfile.ZipFile(shared[0]) as archive:
        archive.extractall(tmp_path)
        names = archive.namelist()
    assert 'binaries/linux64/lts_small.so' in names or os.name != 'posix'
    root = ElementTree.parse(tmp_path / 'modelDescription.xml')
    listed = [file.get('name') for file in root.iter('File')]
    sources = [str(tmp_path / 'sources' / name) for name in listed]
    library = str(tmp_path / 'again.so')
    subprocess.run(
        [*c_library.compiler(), '-O1', '-fPIC', '-shared', f'-I{tmp_path}/sources', *sources,
         '-o', library, '-lm'], check=True,
    )  # fmt: skip
    symbols = subprocess.run(['nm', '-D', library], capture_output=True, text=True).stdout
    assert sum(' T fmi2' in line for line in symbols.splitlines()) == 34


def test_a_spring_and_mass_on_the_soil_stay_bounded(shared, tmp_path):
    """A machine of 2 kg on a spring, its force from the soil, over a range of steps."""
    path, model, found, _ = shared
    ends = []
    for h in (1e-3, 5e-3, model.simulator.scene.dt):
        slave = _Slave(path, tmp_path / f's{h:.4f}')
        x0 = found[0]['points'].mean(axis=0)
        x, v = x0.copy(), np.zeros(3)
        for _ in range(round(0.5 / h)):
            slave.set(pos=x, lin=v)
            slave.step(h)
            v = v + h * (np.clip(slave.get('force'), -5, 5) - 400 * (x - x0) - 20 * v) / 2.0
            x = x + h * v
        slave.free()
        ends.append(x - x0)
        assert np.abs(x - x0).max() < 0.1
    assert np.abs(np.ptp(ends, axis=0)).max() < 0.02
