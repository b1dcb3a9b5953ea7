"""FMUs of a swept field by FMPy, in FMI 2.0 and 3.0, and the arrays of FMI 3.0."""

import numpy as np
import pytest

from learning_to_simulate.export_c import c_library, field_data, fmu, fmu_description
from learning_to_simulate.export_c.c_field import CField
from tests.learning_to_simulate.swept_field import small_world as world

fmpy = pytest.importorskip('fmpy', reason='FMPy is not installed: pip install -e .[fmu]')
from fmpy import fmi3, validation  # noqa: E402
from fmpy.fmi1 import FMICallException  # noqa: E402

pytestmark = pytest.mark.skipif(
    not any(map(c_library.shutil.which, ('cc', 'gcc', 'clang'))), reason='no C compiler'
)
TWIST = np.array([-0.2, -0.1, 0.0, 0.0, 0.0, 0.3])
PARTS = (('pos', 'xyz'), ('rot', ('e0', 'e1', 'e2', 'e3')), ('lin_vel', 'xyz'), ('ang_vel', 'xyz'))
INPUTS = [f'tool_state.{part}.{a}' for part, axes in PARTS for a in axes]
LOADS = [f'tool_load.{part}.{a}' for part in ('force', 'moment') for a in 'xyz']


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """Paths of the FMUs by version, and the field."""
    field, folder = world.make_field(), tmp_path_factory.mktemp('fmu')
    paths = {version: str(folder / f'soil{version}.fmu') for version in fmu.VERSIONS}
    for version, path in paths.items():
        fmu.write(path, 'lts_small', field_data.values(field), version)
    return paths, field


def _pose(start, t):
    half = 0.5 * t * TWIST[5]
    return np.array([*(start + t * TWIST[:3]), np.cos(half), 0.0, 0.0, np.sin(half)])


def _c_forces(field, start, h, n):
    """Loads [n, 6] of the same motion by the library."""
    soil = CField.of(field)
    soil.start(_pose(start, 0.0), TWIST)
    frames = [soil.step(_pose(start, (k + 1) * h), h) for k in range(n)]
    return np.array([np.concatenate(f[:2]) for f in frames]), soil


@pytest.mark.parametrize('version', fmu.VERSIONS)
@pytest.mark.parametrize('h', [1 / 64, 1 / 1024])
def test_is_valid_and_equals_the_library_for_any_step(made, version, h):
    paths, field = made
    path = paths[version]
    assert validation.validate_fmu(path) == []
    description = fmpy.read_model_description(path)
    starts = {v.name: v.start for v in description.modelVariables}
    start, n = np.array([float(starts[name]) for name in INPUTS[:3]]), round(0.25 / h)
    signals = np.zeros(n + 1, dtype=[('time', float), *((name, float) for name in INPUTS)])
    for k in range(n + 1):
        signals[k] = (k * h, *_pose(start, k * h), *TWIST)
    got = fmpy.simulate_fmu(
        path, stop_time=n * h, output_interval=h, input=signals, output=LOADS,
    )  # fmt: skip
    expected, _ = _c_forces(field, start, h, n)
    assert np.abs(expected[:, 5]).max() > 0.1  # a moment, too
    loads = np.stack([got[name] for name in LOADS], axis=1)[1:]
    np.testing.assert_allclose(loads, expected, atol=1e-5 * np.abs(expected).max())


class _Slave:
    """An instance of FMI 3.0 with its variables by name."""

    def __init__(self, path, folder, name):
        description = fmpy.read_model_description(path)
        self.vr = {v.name: v.valueReference for v in description.modelVariables}
        self.start = np.array(
            [float(v.start) for v in description.modelVariables if v.name in INPUTS[:3]]
        )
        self.c = fmi3.FMU3Slave(
            guid=description.instantiationToken,
            unzipDirectory=fmpy.extract(path, unzipdir=str(folder)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.c.instantiate()
        self.c.enterInitializationMode()
        self.put(0.0)
        self.c.exitInitializationMode()
        self.time = 0.0

    def put(self, t):
        values = [*_pose(self.start, t), *TWIST]
        self.c.setFloat64([self.vr[name] for name in INPUTS], values)

    def step(self, h, n):
        for _ in range(n):
            self.put(self.time)
            self.c.doStep(self.time, h)
            self.time += h
        return np.array(self.c.getFloat64([self.vr[name] for name in LOADS]))

    def array(self, name, size):
        return np.array(self.c.getFloat32([self.vr[name]], size), np.float32)


def test_arrays_rollback_and_two_instances(made, tmp_path):
    paths, field = made
    one, other = (_Slave(paths[3], tmp_path / name, name) for name in ('one', 'other'))
    one.step(0.01, 20)
    _, soil = _c_forces(field, one.start, 0.01, 20)
    particles = one.array('particles', field.rest.size)
    np.testing.assert_allclose(particles, soil.particles().ravel(), atol=1e-6)
    origin, cells = fmu_description.grid(field_data.values(field))
    heights = one.array('height_map', cells[0] * cells[1])
    expected = soil.height_map(origin, fmu_description.CELL, cells)
    np.testing.assert_allclose(heights, expected.ravel(), atol=1e-6)
    assert np.isfinite(heights).any() and np.nanstd(heights) > 0
    # Another instance in between changes nothing; a state goes back bit by bit, also elsewhere.
    state = one.c.getFMUState()
    saved, time = one.c.serializeFMUState(state), one.time
    first = one.step(0.013, 7)
    other.step(0.02, 5)
    for slave, at in ((one, state), (other, other.c.deserializeFMUState(saved))):
        slave.c.setFMUState(at)
        slave.time = time
        np.testing.assert_array_equal(slave.step(0.013, 7), first)
        np.testing.assert_array_equal(
            slave.array('particles', field.rest.size), one.array('particles', field.rest.size)
        )
        slave.c.freeFMUState(at)
    for act in (
        lambda: one.array('particles', 5),
        lambda: one.c.getFloat32([0], 1),
        lambda: one.c.setFloat64([one.vr['blade_width']], [0.3]),
        lambda: one.c.setFloat64([one.vr[INPUTS[0]]], [np.nan]),
        lambda: one.c.doStep(one.time, -1.0),
    ):
        with pytest.raises(FMICallException):
            act()
    for slave in (one, other):
        slave.c.terminate()
        slave.c.freeInstance()
