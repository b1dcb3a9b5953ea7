"""Strips of outlines, and runs."""

import numpy as np
import pytest

from mpm import batch, bodies, distance, picture, scenes
from mpm.motions import operator_paths
from mpm.motions.recording import Recording
from mpm.simulation import Settings
from tests.mpm import small


@pytest.mark.parametrize(
    'body',
    [
        bodies.make_blade(0.4),
        bodies.make_wheel(0.15, 0.4),
        bodies.tool_body(operator_paths.bucket(0.1, 0.3, True))._replace(radius=0.0),
    ],
    ids=['blade', 'wheel', 'bucket'],
)
def test_outline_lies_on_the_surface(body):
    pose = (0.5, 0.3, -0.6, 0.4)
    ring = picture.outline(body, pose)
    np.testing.assert_allclose(ring[0], ring[-1])
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    wide = body._replace(half_width=9.0, plates=np.zeros((0, 2)))
    for x, y in ring - pose[:2]:
        assert abs(distance.signed_distance(wide, sine, cosine, x, y, 0.0)[0]) < 1e-12


def test_runs_are_drawn_whatever_moved_the_tool(tmp_path, monkeypatch):
    """A case of the grid, a path of one's own; a drawn tool and a wheel are `body_of`'s."""
    pytest.importorskip('matplotlib')
    monkeypatch.setattr(scenes, 'FRAMES', 2)
    path, file = tmp_path / 'mine.csv', tmp_path / 'runs.png'
    path.write_text('time_s,x_m,y_m,angle_deg\n0,0.8,0.3,0\n0.01,0.8,0.29,-5\n')
    runs, folder = (22, Recording(str(path), 1)), str(tmp_path / 'raw')
    batch.generate(small.BLADE, runs, folder, Settings())
    assert picture.first_of_each_kind(folder) == [22, 'path_mine']
    picture.draw_runs(folder, runs, str(file))
    assert file.read_bytes()[:4] == b'\x89PNG'
    with pytest.raises(ValueError, match='no finished raw runs'):
        picture.first_of_each_kind(str(tmp_path))
