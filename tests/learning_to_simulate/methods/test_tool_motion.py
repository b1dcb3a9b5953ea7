"""Pose of a blade from its particles."""

import numpy as np
import pytest

from learning_to_simulate.methods import tool_motion

FRAME = tool_motion.TravelFrame(axis=0, sign=-1, up=1)


def test_the_pose_of_a_leaning_face():
    rise, lean = np.linspace(0.0, 0.2, 5), 0.3
    face = np.stack([np.stack([rise * np.sin(lean), 0.4 + rise * np.cos(lean), z + 0 * rise], -1)
                     for z in (0.0, 0.1)]).reshape(1, 1, 10, 3)  # fmt: skip
    tip, found = tool_motion.blade_pose(face + [0.7, 0.0, 0.0], FRAME)
    np.testing.assert_allclose(tip, [[[-0.7, 0.4]]])
    assert found[0, 0] == pytest.approx(lean)  # its top lies behind: it travels towards -x


@pytest.mark.filterwarnings('error')
def test_a_body_of_one_row_has_no_lean():
    row = np.array([[0.7, 0.4, z] for z in (0.0, 0.1)])[None, None]
    tip, lean = tool_motion.blade_pose(row, FRAME)
    np.testing.assert_allclose(tip, [[[-0.7, 0.4]]])
    assert lean == 0.0
