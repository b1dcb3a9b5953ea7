"""The machine of springs on a swept field: what it converges to, and when it shakes."""

import numpy as np
import pytest

from learning_to_simulate.export_c import c_library, coupled
from learning_to_simulate.export_c.c_field import CField
from pca_tools import files
from tests.learning_to_simulate.swept_field import small_world as world

pytestmark = pytest.mark.skipif(
    not any(map(c_library.shutil.which, ('cc', 'gcc', 'clang'))), reason='no C compiler'
)
PATH = world.world_pose(world.path()[:, 0])


@pytest.fixture(scope='module')
def soil():
    field = CField.of(world.make_field())
    return coupled.of_field(field, PATH), field


@pytest.mark.parametrize('step', [1, 1 / 4])
def test_stiff_springs_take_the_tool_along_the_path(soil, step):
    """Force of the path alone; the carriage turns as well."""
    machine, field = soil
    run = coupled.drive(machine, step, 5e7)
    field.start(PATH[0], machine.velocity[0])
    at = np.arange(step, len(PATH) - 1 + step / 2, step)
    poses = np.stack([np.interp(at, np.arange(len(PATH)), column) for column in PATH.T], axis=-1)
    expected = np.array([field.step(p / [1, 1, 1, *4 * [np.linalg.norm(p[3:])]], step * world.DT)[0]
                         for p in poses])[:, [0, 1]]  # fmt: skip
    assert run['error'] is None and run['longest'] < 1e-4
    np.testing.assert_allclose(run['time'][-1], world.DT * (len(PATH) - 1))
    # The springs give way by some micrometres.
    assert np.linalg.norm(run['force'] - expected) <= 0.02 * np.linalg.norm(expected)
    np.testing.assert_allclose(machine.velocity[20, 3:], _turning(20), atol=1e-6)


@pytest.mark.parametrize('step', [1 / 16, 1 / 2])
def test_a_force_that_sets_in_stretches_the_springs_as_an_oscillator(soil, step):
    """Constant force on a tool whose carriage stands: F / k and the first overshoot."""
    machine, _ = soil
    stands = machine._replace(
        path=np.repeat(PATH[:1], len(PATH), axis=0),
        velocity=np.zeros((len(PATH) - 1, 6)),
        advance=lambda h, pose, velocity: (np.array([400.0, -100.0, 0.0]), 0),
    )
    overshoot = np.exp(-np.pi * coupled.DAMPING / np.sqrt(1.0 - coupled.DAMPING**2))
    run = coupled.drive(stands, step, 2e4)
    assert run['longest'] == pytest.approx(400.0 / 2e4 * (1.0 + overshoot), rel=0.01)


def _turning(k):
    """Angular velocity about -z of a lean that grows, see `small_world.world_pose`."""
    lean = world.path()[:, 0, 2]
    return [0.0, 0.0, -(lean[k + 1] - lean[k]) / world.DT]


def test_shorter_steps_converge_and_long_ones_are_told(soil, tmp_path):
    machine, _ = soil
    rows = coupled.measure(machine, (1 / 16, 1 / 8, 1 / 2, 2), (2e5,))
    assert [row['stable'] for row in rows] == [True] * 4
    differences = [row['force_difference'] for row in rows]
    assert differences[0] == 0.0 and 0.0 < differences[1] < differences[2] < differences[3]
    # A spring that the soil outweighs: the tool runs off until the soil refuses its place.
    lost = coupled.measure(machine._replace(advance=_pushing(machine)), (1 / 2, 6), (1e3, 1e7))
    assert [row['stable'] for row in lost] == [False, False, True, True]
    assert 'the tool would be' in lost[1]['error'] and lost[3]['error'] is None
    path = str(tmp_path / 'coupled.json')
    files.write_json(path, [{'model': 'small', 'run': 0, 'rows': lost}])
    table = coupled.table(path).splitlines()
    assert table[0] == '| model | step, ms | 1e3 N/m | 1e7 N/m |'
    assert 'unstable (the tool would be' in table[-1] and table[-1].endswith(' mm |')


def _pushing(machine):
    """Soil of a force that grows with the height, a negative spring."""

    def advance(h, pose, velocity):
        _, code = machine.advance(h, pose, velocity)
        return np.array([0.0, 1e5 * (pose[1] - PATH[0, 1]), 0.0]), code

    return advance
