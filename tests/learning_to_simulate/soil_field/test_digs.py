"""Recorded digs from files and datasets."""

import numpy as np
import pytest

from learning_to_simulate.soil_field import digs
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Blade

HEAD = 'run,time_s,x_m,y_m,angle_deg,force_x_N\n'


def read(tmp_path, text, terrain=None, surface=0.0, gravity=9.81):
    file = tmp_path / 'digs.csv'
    file.write_text(text)
    return digs.read(str(file), Blade(), terrain, surface, gravity)


def test_both_kinds_of_columns_say_the_same(tmp_path):
    rows = 'a,5,1,0.2,-20,7\na,5.1,0.99,0.2,-20,\nb,0,0,0,0,1\nb,0.1,0,0,0,2'
    plane = read(tmp_path, HEAD + rows)
    assert [one.name for one in plane] == ['a', 'b']
    one = plane[0]
    np.testing.assert_allclose(one.times, [0, 0.1])
    np.testing.assert_array_equal(one.force, [[7, np.nan, np.nan], [np.nan] * 3])
    half = np.radians(-10)
    text = 'time_s,force_x_N,x_m,y_m,z_m,qw,qx,qy,qz\n' + ''.join(
        f'{t},{f},{x},0.2,0,{np.cos(half)},0,0,{np.sin(half)}\n'
        for t, f, x in ((5, 7, 1), (5.1, '', 0.99))
    )
    other = read(tmp_path, text, surface=0.3)[0]
    np.testing.assert_allclose(one.pose, other.pose)
    assert other.name == 'run' and (other.terrain.heights == 0.3).all()
    low = other.terrain.corner
    high = low + other.terrain.cell * other.terrain.shape
    np.testing.assert_allclose([*low, *high], [-0.51, -1.5, 2.51, 1.5], atol=0.03)


def test_a_terrain_of_ones_own_gives_the_middle(tmp_path):
    ground = Terrain.flat((4.0, 3.0))
    one = read(tmp_path, HEAD + 'a,0,1,0.2,0,7\na,0.1,1,0.2,0,7', ground)[0]
    assert one.terrain is ground and one.pose[0, 2] == pytest.approx(1.5)


@pytest.mark.parametrize(
    'text, message',
    [
        ('time_s,x_m,y_m,force_x_N\n', 'line 1: lacks angle_deg; found'),
        ('time_s,x_m,y_m,angle_deg\n', 'lacks one of force_x_N'),
        ('', 'lacks time_s'),
        (HEAD, 'has no rows'),
        (HEAD + 'a,0,1,0.2,0,7', 'run a: has 1 row, at least 2'),
        (HEAD + 'a,0,1,0.2,0,7\na,0.1,1,0.2,0,nan', 'line 3: force_x_N is nan; leave it empty'),
        (HEAD + 'a,0,1,0.2,0,7\na,0.1,,0.2,0,1', 'line 3: x_m is missing'),
        (HEAD + 'a,0,1,0.2,0,7\na,0.1,one,0.2,0,1', "line 3: x_m is 'one', no number"),
        (HEAD + 'a,0,1,0.2,0,7\na,0.1,1,0.2,0', 'line 3: has 5 cells, the header 6'),
        (HEAD + 'a,0,1,0.2,0,7\na,0,1,0.2,0,7', 'line 3: .*must ascend'),
        (HEAD + 'a,0,1,0.2,0,7\na,17,1,0.2,0,7', 'line 3: .*milliseconds'),
        (HEAD + 'a,0,1000,200,0,7\na,0.02,998,200,0,7', 'line 3: .*100 m/s.*millimetres'),
        (HEAD.replace('run', 'x_m') + 'a,0,1,0.2,0,7', 'stands there twice'),
        ('time_s,force_x_N,x_m,y_m,z_m,qw,qx,qy,qz\n0,1,0,0,0,2,0,0,0\n0.1,1,0,0,0,1,0,0,0',
         'line 2: the quaternion has length 2'),
    ],
)  # fmt: skip
def test_bad_files_are_refused_by_line(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, text)


def test_other_refusals(tmp_path):
    with pytest.raises(ValueError, match='gravity is 0'):
        read(tmp_path, HEAD, gravity=0.0)
    with pytest.raises(FileNotFoundError):
        digs.read(str(tmp_path / 'none.csv'), Blade(), None, 0.0, 9.81)


def test_runs_of_a_dataset():
    one, other = digs.of_dataset('datasets/excavation', ['soils_0019', 'lift_0003'])
    assert (one.name, other.name) == ('soils_0019', 'lift_0003')
    assert one.tool.width == pytest.approx(0.3) and one.terrain.soil.gravity == 9.81
    assert np.isnan(one.force[0]).all() and np.isfinite(one.force[1:, :2]).all()
    with pytest.raises(ValueError, match=r"has no runs \['none'\]"):
        digs.of_dataset('datasets/excavation', ['none'])
    with pytest.raises(ValueError, match='--cases'):
        digs.of_dataset('datasets/excavation', [])
