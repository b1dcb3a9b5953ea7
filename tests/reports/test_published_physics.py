"""The published physics beside ours: what is kept, and what is made of it."""

import json

import numpy as np
import pytest

from mpm import experiments
from reports import published_physics


@pytest.fixture
def coarse(monkeypatch):
    """The report on cells twice as long; returns the cases that it simulates."""
    made, simulate = [], published_physics.simulate
    monkeypatch.setattr(published_physics, 'SCENE', experiments.coarse(published_physics.SCENE))

    def noted(case, physics, frames):
        made.append((case, physics))
        return simulate(case, physics, frames)

    monkeypatch.setattr(published_physics, 'simulate', noted)
    published_physics.packed.cache_clear()
    yield made
    published_physics.packed.cache_clear()


def test_runs_are_kept_and_the_law_tells(coarse, tmp_path):
    path = str(tmp_path / 'physics.json')
    content = published_physics.measure(path, [186], 10, None)
    assert coarse == [(186, name) for name in published_physics.PHYSICS]
    draft = [np.mean(run['force_x_N']) for run in content['runs']]
    assert len(set(draft)) == 3 and min(draft) > 0.0
    assert [run['deepest_cells'] < 0.25 for run in content['runs']] == [True] * 3
    assert content['runs'][1]['time_step_s'] < 0.5 * content['runs'][0]['time_step_s']
    published_physics.measure(path, [186], 10, None)
    assert len(coarse) == 3
    with pytest.raises(ValueError, match='another frames'):
        published_physics.measure(path, [186], 20, None)
    assert published_physics.table(path).count('| 186 |') == 1


def test_published_figures_are_means_of_the_driven_frames():
    force = np.zeros((40, 3))
    force[1:, 0], force[1:, 1] = np.arange(39), 7.0
    found = published_physics.figures_of(force, 25)
    assert found == {'draft_N': 12.0, 'vertical_N': 7.0, 'draft_of_spans_N': [4.5, 14.5]}


def test_table_and_picture_with_and_without_the_published_records(tmp_path):
    runs = [
        {'case': case, 'physics': name, 'force_x_N': [9.0, 10.0 * factor], 'force_y_N': [5.0] * 2,
         'deepest_cells': 0.1, 'cpu_s': 3.0}
        for case in (186, 22) for factor, name in enumerate(published_physics.PHYSICS, 1)
    ]  # fmt: skip
    record = {'draft_N': 5.0, 'vertical_N': 2.0, 'draft_of_spans_N': [5.0]}
    path = tmp_path / 'physics.json'
    for records, last in (({}, '| 22 |'), ({'186': record, '22': record}, '| **all** |')):
        path.write_text(json.dumps({'frames': 2, 'runs': runs, 'records': records}))
        lines = published_physics.table(str(path)).splitlines()
        assert lines[-1].startswith(last)
        picture = tmp_path / 'physics.png'
        published_physics.draw(str(path), str(picture))
        assert picture.stat().st_size > 5000
    # 9.5, 14.5 and 19.5 N against 5.
    assert lines[2].startswith('| 186 | 8, 10, 10 | 9.5 | 1.53 | 2.05 | 5 | 1.9 | 3.9 |')
