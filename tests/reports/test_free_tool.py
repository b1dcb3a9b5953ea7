"""The measures of a free tool on tools and forces that are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from mpm import bodies, contact
from pca_tools import files
from reports import free_tool

WHEEL = {'diameter_m': 0.3}


def _points(body, x=0.6, y=0.3, lean=0.2, middle=0.4):
    return bodies.sample_points(body._replace(z_middle=middle), x, y, lean)


@pytest.mark.parametrize('scene', ['excavation', 'wheel'])
def test_soil_inside_is_that_of_the_solver_and_comes_out(scene):
    body = bodies.make_wheel(0.3, 0.4) if scene == 'wheel' else bodies.make_blade(0.4)
    points = _points(body)
    tool = free_tool.Tool(scene, WHEEL, points)
    rng = np.random.default_rng(0)
    soil = np.array([0.6, 0.3, 0.4]) + rng.uniform(-0.3, 0.3, (4000, 3))
    depth, pushed = tool.inside(soil, points)
    expected = -contact.signed_distances(body, (0.6, 0.3, 0.2), soil)
    np.testing.assert_allclose(depth, np.maximum(expected, 0.0), atol=1e-8)
    assert (depth > 0).sum() > 30 and depth.max() <= tool.radius + 1e-9
    assert tool.inside(pushed, points)[0].max() < 1e-9
    np.testing.assert_array_equal(pushed[depth == 0], soil[depth == 0])
    np.testing.assert_allclose(np.linalg.norm(pushed - soil, axis=1), depth, atol=1e-12)


def test_other_bodies_are_refused():
    points = _points(bodies.make_blade(0.4))
    with pytest.raises(ValueError, match='scene plough'):
        free_tool.Tool('plough', {}, points)
    with pytest.raises(ValueError, match='has 19 particles, not 20'):
        free_tool.Tool('excavation', {}, points[1:])
    with pytest.raises(ValueError, match='m from those of the tool'):
        free_tool.Tool('excavation', {}, points * 1.1)


def test_penetration_counts_prediction_and_truth():
    """Truth 4 mm inside in one frame of two, prediction clear of the tool but 1 m off."""
    points = _points(bodies.make_blade(0.4), lean=0.0)
    tool = free_tool.Tool('excavation', {}, points)
    frames = np.repeat(points[None], free_tool.H + 2 * free_tool.EVERY, axis=0)
    outside, touched = np.array([[1.5, 0.3, 0.4]]), np.array([[0.61, 0.45, 0.4]])
    modes = [outside] * (free_tool.H + free_tool.EVERY) + [touched] * free_tool.EVERY
    rollout = SimpleNamespace(
        truth=(modes, frames, None), body=frames, modes=modes[free_tool.H :],
        particles=lambda frame: outside,
    )  # fmt: skip
    recorded = SimpleNamespace(
        position=np.concatenate([frames, np.array(modes)], axis=1), n_rigid=frames.shape[1]
    )
    row = free_tool.penetration(tool, rollout, SimpleNamespace(particles=np.asarray), recorded)
    assert row['deepest_mm'] == 0.0 and row['particles'] == 0.0
    assert row['true_deepest_mm'] == pytest.approx(4.0) and row['true_particles'] == 0.5
    assert row['error_mm'] == row['pushed_error_mm'] > 300.0


def test_forces_where_there_are_none():
    true = np.zeros((free_tool.H + 4, 3))
    true[-1] = 50.0
    force = np.array([[0.0, 0, 0], [0, 1.5, 0], [3, 4, 0], [30, 40, 0]])
    rollout = SimpleNamespace(truth=(None, None, true), force=force)
    assert free_tool.free(rollout) == {'free_frames': 3, 'free_N': 6.5, 'free_small': 2}


def test_force_at_a_halt_and_the_table(tmp_path):
    """Two halts: one within a frame, one that takes ten; only the first one counts."""
    n, dt = 120, 1 / 60
    speed = np.full(n - 1, 0.1)
    speed[30], speed[31:60] = 0.06, 0.0
    speed[80:90] = np.linspace(0.1, 0.0, 10)
    speed[90:] = 0.0
    body = np.zeros((n, 5, 3))
    body[1:, :, 0] = np.cumsum(speed * dt)[:, None]
    true = np.zeros((n, 3))
    true[:, 0], true[31:60, 0] = 200.0, 50.0
    force = true[free_tool.H :] + [0.0, 3.0, 0.0]
    force[30 - free_tool.H : 37 - free_tool.H, 1] = 40.0
    found = free_tool.halts(SimpleNamespace(truth=(None, body, true), force=force), dt)
    assert found['halts'] == 1 and found['halt_frames'] == 7
    assert found['other_frames'] == n - free_tool.H - 7
    assert (found['halt_before_N'], found['halt_after_N']) == (200.0, 50.0)
    row = found | {
        'start_first_N': 1.0, 'start_later_N': 2.0, 'deepest_mm': 3.0, 'true_deepest_mm': 4.0,
        'particles': 5.0, 'true_particles': 6.0, 'error_mm': 2.0, 'pushed_error_mm': 3.0,
    }  # fmt: skip
    path = str(tmp_path / 'free_tool.json')
    old = {k: v for k, v in row.items() if not k.startswith(('halt', 'other'))}
    models = [{'model': 'm', 'runs': [row, row | {'air_N': 7.0}]}, {'model': 'old', 'runs': [old]}]
    files.write_json(path, {'models': models})
    new, before = free_tool.table(path).splitlines()[-2:]
    assert new == '| m | 7 |  | 1 | 2 | 40 | 3 | 200 to 50 | 3.0 / 4.0 | 5.0 / 6.0 | 1.5 |'
    assert before == '| old |  |  | 1 | 2 |  |  |  | 3.0 / 4.0 | 5.0 / 6.0 | 1.5 |'
