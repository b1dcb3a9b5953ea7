"""Runs with another packing beside those of the record; its table is held by the documents."""

import numpy as np
import pytest

from learning_to_simulate.soil_field import runs as runs_lib
from reports import packing


def test_a_run_beside_itself_and_beside_one_of_twice_the_load(monkeypatch):
    brief = next(r for r in runs_lib.read('datasets/wheel_more', 'test') if r.kind == 'brief')
    twice = brief._replace(force=2 * brief.force, heights=brief.heights + 1e-3)
    same, apart = packing.judged('wheel', [brief, twice])
    assert same['case'] == brief.case and same['usual'] == same['other']
    assert set(same['apart'].values()) == {0.0} and 0 < same['usual']['force_relative_l2'] < 1
    apart = apart['apart']
    assert apart['force_relative_l2'] == apart['drawbar_relative_l2'] == 1.0
    assert apart['near_mm'] == pytest.approx(1.0, abs=1e-3)
    assert 'height_mm' not in apart
    free = next(r for r in runs_lib.read('datasets/wheel', 'test') if r.machine)
    raised = free._replace(pose=free.pose + [0, 2e-3, 0, 0, 0, 0, 0])
    later, other = free.particles.copy(), free.particles + np.float32(1e-5)
    later[1:] += np.float32(3e-3)
    moved, packed = packing.judged(
        'wheel', [raised._replace(particles=later), raised._replace(particles=other)]
    )
    assert moved['moved'] and not packed['moved'] and 'soil_mm' not in packed['apart']
    assert moved['apart']['height_mm'] == pytest.approx(2.0)
    assert moved['apart']['soil_mm'] == pytest.approx(3.0, rel=1e-3)
    assert 0 < moved['usual']['height_mm'] < 5 and 0 < moved['usual']['soil_mm'] < 5
    monkeypatch.setattr(runs_lib, 'read_all', lambda *_, **__: [brief])
    with pytest.raises(ValueError, match='brief_9999: no such run in datasets wheel, wheel_more'):
        packing.judged('wheel', [brief._replace(case='brief_9999')])
