"""Long runs of shipped models: the figures are those of the same frames one by one."""

import numpy as np
import pytest

from learning_to_simulate import registry
from learning_to_simulate.export_c import c_library, c_stepper, endurance, starts
from learning_to_simulate.export_c.c_field import CField
from pca_tools import dataset, files

pytestmark = pytest.mark.skipif(
    not any(map(c_library.shutil.which, ('cc', 'gcc', 'clang'))), reason='no C compiler'
)
MODEL, DATA = 'models/excavation/pcg', 'datasets/excavation'
FIELD, FIELD_DATA = 'models/excavation_v2/swept_field', 'datasets/excavation_v2'
FRAMES = 1100


def _there_and_back(path, count):
    whole = np.concatenate([path, path[-2:0:-1]])
    return (whole[k % len(whole)] for k in range(count))


def test_a_model_in_the_subspace_again_and_without_end(tmp_path):
    again = endurance.measure(MODEL, DATA, FRAMES, 'again')
    endless = endurance.measure(MODEL, DATA, FRAMES, 'without end')
    model, n, space, found = starts.read_model(MODEL, DATA)
    nodes = registry.open_model(MODEL, DATA, 'test').groups[0].position[0]
    stepper = c_stepper.CStepper(model, n, space, starts=found)

    def largest(frames):
        seen = [(np.abs(f.modes).max(), np.abs(f.force).max()) for f in frames]
        return np.max(seen, axis=0)

    stepper.reset(nodes[:6])
    once = largest(map(stepper.step, nodes[6:, :n]))
    stepper.reset(nodes[:6])
    far = largest(map(stepper.step, _there_and_back(nodes[6:, :n], FRAMES)))
    for row, expected in ((again, once), (endless, far)):
        assert row['frames'] == row['largest'][-1]['frames'] == FRAMES and not row['not_finite']
        assert row['state_bytes'] == [len(stepper.save())] * 2
        # The command compiles with less optimisation than the stepper.
        got = [max(r[key] for r in row['largest']) for key in ('mode_or_torque', 'force')]
        np.testing.assert_allclose(got, expected, rtol=1e-3)
    assert again['status'] == 0 and endless['status'] & 16  # left bounds
    assert far[0] > 2 * once[0]
    path = str(tmp_path / 'endurance.json')
    files.write_json(path, [{'model': MODEL, 'way': 'without end'} | endless])
    row = endurance.table(path).splitlines()[-1]
    assert '| 1.1e3 | 0 | 992 |' in row and row.endswith('speed, left bounds |')


def test_a_swept_field_without_end_and_values_that_are_not_finite(monkeypatch):
    row = endurance.measure(FIELD, FIELD_DATA, FRAMES, 'without end')
    poses = dataset.read_split(FIELD_DATA, 'test')[0].rigid_pose.astype(np.float64)
    soil = CField.load(FIELD)
    soil.start(poses[0])
    frames = [soil.step(pose) for pose in _there_and_back(poses[1:], FRAMES)]
    got = [max(r[key] for r in row['largest']) for key in ('mode_or_torque', 'force')]
    expected = [max(np.abs(f[i]).max() for f in frames) for i in (1, 0)]
    np.testing.assert_allclose(got, expected, rtol=1e-4)
    assert row['not_finite'] == 0 and row['state_bytes'] == [len(soil.save())] * 2
    # A force that no float holds is counted, once per component and frame.
    monkeypatch.setattr(
        endurance.field_data, 'values', lambda field, v=endurance.field_data.values: v(field)
        | {'force': 3e38}
    )  # fmt: skip
    assert endurance.measure(FIELD, FIELD_DATA, 200, 'again')['not_finite'] > 0
