"""Pictures of a tool on a terrain: what is drawn where, from arrays made up here."""

import json

import numpy as np
import pytest

from learning_to_simulate import render_rollout
from learning_to_simulate.rendering import terrain_views
from pca_tools import files

HEIGHT, RISE = 0.2, 0.05


def arrays(frames=9, **more):
    """A blade that goes along -x; behind x = 0.5 m the terrain rises step by step."""
    pose = np.tile([0.8, 0.25, 0.3, 1.0, 0, 0, 0], (frames, 1))
    pose[:, 0] -= 0.05 * np.arange(frames)
    maps = np.full((3, 50, 30), HEIGHT)
    maps[:, 25:] += RISE * np.arange(3)[:, None, None] / 2
    outline = np.array([[-0.01, 0], [0.01, 0], [0.01, 0.2], [-0.01, 0.2]])
    tool = {'name': 'blade', 'width': 0.3}
    return {
        'pose': pose, 'predicted_forces': np.tile([30.0, 10.0, 0], (frames, 1)),
        'height_frames': np.array([0, 4, 8]), 'heights_before': maps[0], 'predicted_heights': maps,
        'corner': np.array([0.0, 0.0]), 'cell': np.array([0.02, 0.02]), 'outline': outline,
        'dt': np.array(0.1), 'tool': np.array(json.dumps(tool)), 'status': np.array('ok'),
        'status_reason': np.array(''),
    } | more  # fmt: skip


def test_section_map_and_force_are_those_of_the_arrays():
    truth = {
        'ground_truth_heights': arrays()['predicted_heights'] - 0.01,
        'ground_truth_forces': np.tile([20.0, 5.0, 0], (9, 1)),
        'case': np.array('lift_0001'),
    }
    points = np.zeros((3, 4, 3))
    truth |= {'predicted_particles': points, 'ground_truth_particles': points + 0.002}
    figure = terrain_views.figure(arrays(**truth), [1, 2], 50)
    title = 'A blade of 30 cm width on the run lift_0001\nforce off by 54 %, soil by 2 mm'
    assert figure.get_suptitle() == title
    names = [text.get_text() for text in figure.axes[-1].get_legend().get_texts()]
    assert names == [
        f'{way}, {name}' for way in ('against the way', 'up') for name in ('solver', 'model')
    ]
    side, plan, true_plan, last_side = figure.axes[:4]
    now, true, was = side.get_lines()
    u, heights = now.get_data()
    # The way begins at x = 0.8 m, so u = 0.3 m is x = 0.5 m.
    np.testing.assert_allclose(heights[u < 0.28], HEIGHT + RISE / 2)
    np.testing.assert_allclose(heights[u > 0.32], HEIGHT)
    np.testing.assert_allclose(true.get_ydata(), heights - 0.01)
    np.testing.assert_allclose(was.get_ydata(), HEIGHT)
    tool = side.patches[0].get_xy()
    np.testing.assert_allclose(tool.min(axis=0), [0.2 - 0.01, 0.25], atol=1e-9)
    image = plan.get_images()[0].get_array()
    assert image.shape == (30, 50) and image.max() == pytest.approx(1e3 * RISE / 2)
    assert true_plan.get_images()[0].get_array().max() == pytest.approx(1e3 * RISE / 2 - 10)
    (ends,) = plan.get_lines()
    np.testing.assert_allclose(ends.get_xdata(), 0.6)
    np.testing.assert_allclose(sorted(ends.get_ydata()), [0.15, 0.45])
    assert last_side.get_title(loc='left') == 't = 0.80 s'
    forces = [line for line in figure.axes[-1].get_lines() if len(line.get_xdata()) == 9]
    np.testing.assert_allclose([line.get_ydata()[0] for line in forces], [20, 30, 5, 10])


def test_of_a_wheel_the_error_of_the_drawbar_is_first():
    wheel = {'tool': np.array(json.dumps({'name': 'wheel', 'width': 0.1}))}
    truth = {'ground_truth_forces': np.tile([20.0, 0, 0], (9, 1))}
    title = terrain_views.figure(arrays(**wheel, **truth), [1], 50, 'mine').get_suptitle()
    assert title == (
        'mine: a wheel of 10 cm width on a given path\n'
        'drawbar (force along the way) off by 50 %, whole force by 71 %'
    )


def test_of_a_large_terrain_what_lies_about_the_path_is_drawn():
    """The same picture where 5 m of terrain lie around the small one."""
    wide = np.pad(arrays()['predicted_heights'], ((0, 0), (250, 250), (250, 250)), mode='edge')
    wide[:, 0, 0] = 5.0  # far away
    large = arrays(heights_before=wide[0], predicted_heights=wide, corner=np.array([-5.0, -5.0]))
    side, plan = terrain_views.figure(large, [2], 50).axes[:2]
    limits = [*plan.get_xlim(), *plan.get_ylim()]
    np.testing.assert_allclose(limits, [-0.3, 1.5, -0.4, 1.0], atol=0.021)
    u, heights = side.get_lines()[0].get_data()
    assert heights.max() == pytest.approx(HEIGHT + RISE)
    assert (u[0], u[-1]) == pytest.approx((-0.4, 0.8))


def test_a_map_lies_on_its_longer_side():
    maps = np.full((3, 30, 50), HEIGHT)
    maps[2, :10, 40:] += RISE
    lies = arrays(heights_before=maps[0], predicted_heights=maps, corner=np.array([0.3, 0.0]))
    _, plan = terrain_views.figure(lies, [2], 50).axes[:2]
    assert (plan.get_xlabel(), plan.get_ylabel()) == ('z (m)', 'model\nx (m)')
    np.testing.assert_allclose([*plan.get_xlim(), *plan.get_ylim()], [0.0, 1.0, 0.3, 0.9])
    image = plan.get_images()[0].get_array()
    assert image.shape == (30, 50) and (image[:10, 40:] > 49).all()
    (ends,) = plan.get_lines()
    np.testing.assert_allclose(ends.get_ydata(), 0.4)
    np.testing.assert_allclose(sorted(ends.get_xdata()), [0.15, 0.45])


def test_files_are_drawn_and_what_failed_is_said(tmp_path):
    path = str(tmp_path / 'rollout_test_0.npz')
    files.write_npz(path, **arrays())
    assert render_rollout._is_on_terrain(path) and not render_rollout._is_on_terrain(__file__)
    for kind in ('png', 'gif'):
        render_rollout.draw_terrain(files.read_npz(path), f'{path}.{kind}')
        assert (tmp_path / f'rollout_test_0.npz.{kind}').stat().st_size > 1000
    with pytest.raises(ValueError, match='must end in .png, .gif or .mp4'):
        render_rollout.draw_terrain(arrays(), f'{path}.vtp')
    failed = {name: np.nan * arrays()[name] for name in ('pose', 'predicted_heights')}
    said = {'status': np.array('non_finite'), 'status_reason': np.array('refused: it jumps')}
    figure = terrain_views.figure(arrays(**failed, **said), [0], 50)
    assert [text.get_text() for text in figure.axes[0].texts] == ['no prediction']
    assert 'refused: it jumps' in figure.get_suptitle()
