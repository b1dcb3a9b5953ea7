"""Axes of bodies; the pose of a blade from its particles."""

import numpy as np
import pytest

from learning_to_simulate.axes import Axes, blade_pose


def test_the_axes_of_bodies_are_those_of_most():
    way = np.linspace(0.0, 1.0, 5)[:, None, None]
    there, other = (np.zeros((1, 5, 4, 3)) + way * step for step in ([0, 0.1, -0.5], [0.4, 3, 0]))
    assert Axes.of_bodies([there, other, there], 1) == Axes(2, -1, 1)


@pytest.mark.filterwarnings('error')
def test_the_pose_of_a_face_and_of_one_row_which_has_no_lean():
    rise, lean = np.linspace(0.0, 0.2, 5), 0.3
    face = np.stack([np.stack([rise * np.sin(lean), 0.4 + rise * np.cos(lean), z + 0 * rise], -1)
                     for z in (0.0, 0.1)]).reshape(1, 1, 10, 3)  # fmt: skip
    for body, expected in ((face, lean), (face[:, :, ::5], 0.0)):
        tip, found = blade_pose(body + [0.7, 0.0, 0.0], Axes(axis=0, sign=-1, up=1))
        np.testing.assert_allclose(tip, [[[-0.7, 0.4]]])
        assert found[0, 0] == pytest.approx(expected)  # its top lies behind: it goes towards -x
