"""What an id means."""

import numpy as np
import pytest

from mpm import scenes
from mpm.motions import catalogue, operator_paths
from mpm.motions.recording import Recording


def test_a_tool_of_the_other_scene_is_refused():
    wheel = {'name': 'mine', 'radius': 0.1, 'width': 0.1, 'friction': 0.5}
    with pytest.raises(ValueError, match="'mine' does not belong into the scene 'excavation'"):
        catalogue.motion_of(scenes.EXCAVATION, 22, wheel)
    bucket = operator_paths.bucket(0.1, 0.3, True)
    with pytest.raises(ValueError, match="'bucket' does not belong into the scene 'wheel'"):
        catalogue.motion_of(scenes.WHEEL, 'slip_0001', bucket)


def test_a_tool_of_ones_own_takes_the_place_of_the_usual_one():
    tool = {'name': 'mine', 'radius': 0.11, 'width': 0.09, 'friction': 0.4}
    for case in ('slip_0002', 122):
        motion = catalogue.motion_of(scenes.WHEEL, case, tool)
        assert motion.drive.body.radius == 0.11 and motion.parameters['tool'] == tool


def test_long_file_makes_a_long_run(tmp_path):
    path = tmp_path / 'long.csv'
    rows = [f'{t:.1f},{0.8 - 0.02 * t:.3f},0.3,0' for t in np.arange(0, 10.05, 0.1)]
    path.write_text('time_s,x_m,y_m,angle_deg\n' + '\n'.join(rows) + '\n')
    motion = catalogue.motion_of(scenes.EXCAVATION, Recording(str(path), 1))
    assert (motion.case, motion.frames) == ('path_long', 600)


@pytest.mark.parametrize('case', ['dig_0001', 'lift', 'lift_x', 'slip_0001', '', 'lift_-1'])
def test_unknown_ids_are_refused(case):
    with pytest.raises(ValueError, match='excavation has no run.*smooth_0012'):
        catalogue.motion_of(scenes.EXCAVATION, case)


def test_seeds_take_turns_through_the_kinds():
    assert catalogue.select_seeds(scenes.EXCAVATION, '9000-9004, 3') == (
        'smooth_9000', 'stops_9001', 'reverse_9002', 'lift_9003', 'disturbed_9004', 'lift_0003',
    )  # fmt: skip
    chosen = catalogue.select_seeds(scenes.WHEEL, '4,5', 'stops,reverse')
    assert chosen == ('stops_0004', 'reverse_0005')


@pytest.mark.parametrize(
    ('seeds', 'kinds', 'words'),
    [
        ('1', 'dig', r"unknown kinds \['dig'\] of excavation; there are smooth, stops"),
        ('a', None, "got 'a'"),
        ('3-', None, "got '3-'"),
        ('5-3', None, 'a range of -1|a range of 0'),
        ('1,1', None, 'twice'),
        ('1-2,2', None, 'twice'),
        ('-4', None, "got '-4'"),
    ],
)
def test_bad_seeds_are_refused(seeds, kinds, words):
    with pytest.raises(ValueError, match=words):
        catalogue.select_seeds(scenes.EXCAVATION, seeds, kinds)


def test_runs_are_named_by_case_or_by_kind_and_seed():
    scene = scenes.EXCAVATION
    assert catalogue.select_runs(scene, ['lift_3', ' 21']) == (21, 'lift_0003')
    assert catalogue.select_runs(scenes.WHEEL, ['full']) == tuple(range(1, 244))
    assert catalogue.select_runs(scene, ['mini']) == scene.mini
    for names in ([], ['lift_0003', 'lift_3'], ['21', '21'], ['slip_0001'], ['999'], ['0'], ['']):
        with pytest.raises(ValueError):
            catalogue.select_runs(scene, names)
