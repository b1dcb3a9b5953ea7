"""Paths from CSV files: what they become, and what is refused with its line."""

import numpy as np
import pytest

from mpm import scenes
from mpm.motions.recording import Recording, read_rows, recorded_drive

HEADER = 'time_s,x_m,y_m,angle_deg'


def write(tmp_path, *lines, header=HEADER):
    path = tmp_path / 'mine.csv'
    path.write_text('\n'.join([header, *lines]) + '\n', encoding='utf-8')
    return str(path)


def drive_of(path, scene=scenes.EXCAVATION, **options):
    return recorded_drive(scene, Recording(path, scenes.WHEEL.demo_case, **options))


def test_path_goes_through_its_rows_and_rests_outside(tmp_path):
    rows = [(2.0, 0.80, 0.28, -10.0), (2.5, 0.78, 0.24, -20.0), (3.5, 0.70, 0.22, -20.0)]
    path = write(tmp_path, *(','.join(map(str, row)) for row in rows))
    drive, parameters, seconds = drive_of(path, blade_width=0.30)
    rows = np.array(rows)
    middle = np.full(len(rows), scenes.EXCAVATION.bin.z_middle)
    expected = np.column_stack([rows[:, 1:3], np.radians(rows[:, 3]), middle])
    poses = drive.pose(np.array([0.0, 0.5, 1.5]))  # the first row is the run's time 0
    np.testing.assert_allclose(poses, expected, atol=1e-12)
    np.testing.assert_array_equal(drive.pose(np.array([-1.0, 9.0])), drive.pose([0.0, 1.5]))
    between = drive.pose(np.linspace(0.5, 1.5, 101))  # a spline would leave the range of its rows
    assert (between[:, 1] <= 0.24).all() and (between[:, 2] == np.radians(-20.0)).all()
    assert seconds == 1.5 and drive.body.half_width == 0.15
    assert parameters['kind'] == 'path' and parameters['blade_width_m'] == 0.30


def test_columns_in_any_order_more_columns_and_a_byte_order_mark(tmp_path):
    path = tmp_path / 'mine.csv'
    text = 'note,angle_deg,x_m,time_s,y_m\nhi,-5,0.8,0,0.3\n\nho,-6,0.7,1,0.29\n'
    path.write_text(text, encoding='utf-8-sig')
    rows = read_rows(str(path))
    np.testing.assert_array_equal(rows['x_m'], [0.8, 0.7])
    np.testing.assert_array_equal(rows['angle_deg'], [-5.0, -6.0])


def test_load_of_the_wheel(tmp_path):
    header = HEADER + ',load_N'
    path = write(tmp_path, '0,0.38,0,0,150', '2,0.35,0,60,200', header=header)
    drive, parameters, _ = drive_of(path, scenes.WHEEL)
    times = np.array([-1.0, 0.0, 1.0, 2.0, 9.0])
    expected = np.outer([150, 150, 175, 200, 200], [0.0, -1.0, 0.0])
    np.testing.assert_allclose(drive.machine.force(times), expected)
    assert drive.machine.is_free == (False, True, False)
    demo = scenes.WHEEL.parameters(scenes.WHEEL.demo_case)
    assert parameters['diameter_m'] == demo['diameter_m'] == 2 * drive.body.radius
    drive, _, _ = drive_of(write(tmp_path, '0,0.38,0,0', '2,0.35,0,60'), scenes.WHEEL)
    assert drive.machine.force(np.zeros(1))[0, 1] == -scenes.wheel_load(demo)


GOOD = ('0,0.8,0.3,0', '0.1,0.79,0.3,0')


@pytest.mark.parametrize(
    ('lines', 'words'),
    [
        ((*GOOD, '0.2,0.78,,0'), 'line 4: y_m is missing'),
        ((*GOOD, '0.2,nan,0.3,0'), 'line 4: x_m is nan'),
        ((*GOOD, '0.2,0.78,low,0'), "line 4: y_m is 'low', no number"),
        ((*GOOD, '0.2,0.78,0.3'), 'line 4: has 3 cells, the header 4'),
        ((*GOOD, '0.1,0.78,0.3,0'), 'line 4: time_s is 0.1 after 0.1; times must ascend'),
        ((*GOOD, '0.2,780,0.3,0'), 'line 4: x_m is 780.*millimetres'),
        (('0,0.8,0.3,0', '5333,0.7,0.3,0'), 'line 3: lasts 5333 s.*milliseconds'),
        ((*GOOD, '0.2,0.7,0.3,0', '1.3,0.6,0.3,0'), 'lines 4 to 5: a gap of 1.1 s.*0.1 s apart'),
        (('0,0.8,0.3,0',), 'has 1 rows, at least 2'),
    ],
)  # fmt: skip
def test_bad_rows_are_refused_with_their_line(tmp_path, lines, words):
    with pytest.raises(ValueError, match=words):
        read_rows(write(tmp_path, *lines))


def test_bad_headers_no_text_and_no_file_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"line 1: lacks the columns \['x_m', 'y_m'\]"):
        read_rows(write(tmp_path, *GOOD, header='time_s,x,y,angle_deg'))
    with pytest.raises(ValueError, match='line 1: .*twice'):
        read_rows(write(tmp_path, *GOOD, header=HEADER + ',x_m'))
    (tmp_path / 'noise.csv').write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match='no CSV text'):
        read_rows(str(tmp_path / 'noise.csv'))
    with pytest.raises(FileNotFoundError):
        read_rows(str(tmp_path / 'nothing.csv'))


def test_id_is_made_of_the_file_name():
    assert Recording('/some where/my path (2).csv', 1).case == 'path_my-path-2-'
