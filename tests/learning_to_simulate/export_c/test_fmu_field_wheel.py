"""FMUs of a wheel's swept field by FMPy: rotation, travel and load in; sinkage and force out."""

import numpy as np
import pytest

from learning_to_simulate.export_c import c_library, field_data, fmu
from learning_to_simulate.export_c.c_field import CField
from tests.learning_to_simulate.swept_field import small_wheel as world

fmpy = pytest.importorskip('fmpy', reason='FMPy is not installed: pip install -e .[fmu]')
from fmpy import fmi2, validation  # noqa: E402
from fmpy.fmi1 import FMICallException  # noqa: E402

pytestmark = pytest.mark.skipif(
    not any(map(c_library.shutil.which, ('cc', 'gcc', 'clang'))), reason='no C compiler'
)
SPEED, SPIN = -0.03, 0.6  # along the world's x, m/s, and about its z, rad/s: it slips
PARTS = (('pos', 'xyz'), ('rot', ('e0', 'e1', 'e2', 'e3')), ('lin_vel', 'xyz'), ('ang_vel', 'xyz'))
INPUTS = [*(f'wheel_state.{part}.{a}' for part, axes in PARTS for a in axes), 'load']
OUTPUTS = ['sinkage', *(f'wheel_load.{part}.{a}' for part in ('force', 'moment') for a in 'xyz')]


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """Paths of the FMUs by version, and the field with its starts."""
    field, folder = world.make_field(), tmp_path_factory.mktemp('fmu')
    parts = world.two_starts(field)
    paths = {version: str(folder / f'wheel{version}.fmu') for version in fmu.VERSIONS}
    for version, path in paths.items():
        fmu.write(path, 'lts_wheel', field_data.values(field, **parts), version)
    return paths, field, parts


def _inputs(start, t):
    """Values of `INPUTS`; the height is of no meaning."""
    half = 0.5 * SPIN * t
    place = start[:3] + [SPEED * t, 0.5, 0.0]
    turn = [np.cos(half), 0.0, 0.0, np.sin(half)]
    return [*place, *turn, SPEED, 0.0, 0.0, 0.0, 0.0, SPIN, _load(t)]


def _load(t):
    return 120.0 + 100.0 * t


def _by_the_library(made, h, n, index=0):
    """Outputs [n, 7] of the same motion."""
    _, field, parts = made
    soil, rows = CField.of(field, **parts), []
    pose, context = soil.start_of(index)
    context[2] = _load(0.0)
    soil.start(None, [SPEED, 0, 0, 0, 0, SPIN], index=index, context=context)
    for k in range(n):
        context[2] = _load(k * h)
        frame = soil.step(np.array(_inputs(pose, (k + 1) * h)[:7]), h, context)
        rows.append([pose[1] - frame.point[1], *frame.force, *frame.torque])
    return np.array(rows)


@pytest.mark.parametrize('version', fmu.VERSIONS)
@pytest.mark.parametrize('h', [1 / 64, 1 / 512])
def test_is_valid_and_equals_the_library_for_any_step(made, version, h):
    paths, _, parts = made
    assert validation.validate_fmu(paths[version]) == []
    start, n = parts['starts'].pose[0], round(0.5 / h)
    signals = np.zeros(n + 1, dtype=[('time', float), *((name, float) for name in INPUTS)])
    for k in range(n + 1):
        signals[k] = (k * h, *_inputs(start, k * h))
    got = fmpy.simulate_fmu(
        paths[version], stop_time=n * h, output_interval=h, input=signals, output=OUTPUTS,
        start_values={'start': 0},
    )  # fmt: skip
    expected = _by_the_library(made, h, n)
    assert np.ptp(expected, axis=0)[[0, 1, 2, 6]].min() > 1e-4
    found = np.stack([got[name] for name in OUTPUTS], axis=1)[1:]
    np.testing.assert_allclose(found[:, 0], expected[:, 0], atol=1e-8)
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_starts_loads_and_rollback(made, tmp_path):
    path, _, parts = made[0][2], *made[1:]
    description = fmpy.read_model_description(path)
    vr = {v.name: v.valueReference for v in description.modelVariables}
    causes = {v.name: v.causality for v in description.modelVariables}
    assert causes['load'] == 'input' and causes['gravity'] == 'parameter'
    slave = fmi2.FMU2Slave(
        guid=description.guid, unzipDirectory=fmpy.extract(path, unzipdir=str(tmp_path / 'fmu')),
        modelIdentifier=description.coSimulation.modelIdentifier, instanceName='one',
    )  # fmt: skip
    slave.instantiate()
    slave.setupExperiment()
    slave.enterInitializationMode()
    slave.setInteger([vr['start']], [1])
    names = [f'wheel_load.point.{a}' for a in 'xyz']
    place = slave.getReal([vr[name] for name in names])
    np.testing.assert_array_equal(place, parts['starts'].pose[1, :3])
    slave.setReal([vr[n] for n in INPUTS], _inputs(np.array(place), 0.0))
    slave.exitInitializationMode()

    def go(first, n, h=0.01):
        for k in range(first, first + n):
            slave.setReal([vr[name] for name in INPUTS], _inputs(np.array(place), k * h))
            slave.doStep(k * h, h)
        return slave.getReal([vr[name] for name in OUTPUTS])

    go(0, 10)
    state = slave.getFMUstate()
    first = go(10, 10)
    slave.setFMUstate(state)
    assert go(10, 10) == first
    for name, value in (('gravity', 3.0), ('load', np.nan)):
        with pytest.raises(FMICallException):
            slave.setReal([vr[name]], [value])
    slave.setReal([vr['load']], [-1.0])
    with pytest.raises(FMICallException):
        slave.doStep(0.2, 0.01)
    slave.freeFMUstate(state)
    slave.terminate()
    slave.freeInstance()
