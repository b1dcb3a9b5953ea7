"""The page of a rollout: what stands on it does not run into each other."""

import dataclasses

import numpy as np

from learning_to_simulate.rendering import particle_views, rollout_figures, rollout_frames
from tests.learning_to_simulate import synthetic_rollout


def test_long_names_stay_beside_their_rows(tmp_path):
    rollout_path, data_path, *_ = synthetic_rollout.write(str(tmp_path), 60)
    frames = rollout_frames.load(rollout_path, data_path, 'a_model_of_a_long_name')
    view = particle_views.setup(frames, 'xy', np.arange(0, 54, 3))
    # The bin of the wheel: low, and its ticks have two decimals.
    flat = dataclasses.replace(view, limits=np.array([[0.08, 0.52], [0.09, 0.28]]))
    figure = rollout_figures.strip_figure(frames, flat, [0, 20, 40], dpi=50, beside=[frames])
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    labels = [a.yaxis.label for a in figure.axes if 'a_model' in a.get_ylabel()]
    boxes = [label.get_window_extent(renderer) for label in labels]
    assert len(boxes) == 3  # two predictions and the error
    for above, below in zip(boxes, boxes[1:]):
        assert below.y1 < above.y0
    assert min(box.x0 for box in boxes) > 0
