"""The shipped models in C over recorded runs, against TensorFlow."""

import pytest

from learning_to_simulate import registry
from learning_to_simulate.native import exporting
from tests.learning_to_simulate.native.worlds import needs_c

pytestmark = needs_c
SHIPPED = [('excavation', 'pcg_thesis'), ('wheel', 'pcg')]


@pytest.mark.parametrize('scene, name', SHIPPED)
def test_shipped_graphs_over_a_rollout(scene, name):
    paths = f'models/{scene}/{name}', f'datasets/{scene}'
    group = registry.open_model(*paths, 'test').groups[0].select(0)
    row = exporting.over_frames(*exporting.CModel(*paths).steppers(), group)
    assert row['frames'] > 40 and row['same_status'] == row['frames']
    # As a share of the motion and of the largest force.
    assert row['position'] <= 1e-5 and row['force'] <= 1e-5
    # Two float32 decodings of positions of a metre, each right to 2e-7.
    assert 0 < row['particles_m'] <= 1e-6
