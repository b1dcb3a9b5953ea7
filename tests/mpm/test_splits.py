"""Splits and order of the data of record."""

from collections import Counter

import numpy as np
import pytest

from mpm import scenes, splits
from mpm.motions import beyond, catalogue

SCENES = pytest.mark.parametrize('scene', scenes.SCENES.values(), ids=lambda scene: scene.name)


@SCENES
def test_each_kind_has_ten_runs_to_test_and_five_to_choose(scene):
    for kind, count in splits.RUNS[scene.name].items():
        runs = splits.runs_of_kinds(scene, (kind,))
        more = splits.MORE[scene.name].get(kind, 0)
        found = [splits.split_of(scene, case) for case in runs]
        counted = Counter(found[:count])
        assert len(runs) == count + more and (counted['test'], counted['valid']) == (10, 5), kind
        assert found[count:] == ['train'] * more
        assert splits.split_of(scene, catalogue.seed_case(kind, count + more)) is None
    assert {*splits.RUNS[scene.name], beyond.KIND} == set(catalogue.KINDS[scene.name])


@SCENES
def test_grid_is_split_by_the_path_in_time(scene):
    """No test run moves its tool as a training run does; the demo's and published cases are in."""
    cases = splits.grid_runs(scene)
    assert len(cases) == len(set(cases)) == 40
    found = Counter(splits.split_of(scene, case) for case in cases)
    assert found['test'] >= 10 and found['valid'] >= 5
    times = np.arange(scenes.FRAMES) / scenes.FRAME_RATE
    paths: dict[bytes, set] = {}
    for case in cases:
        pose = catalogue.motion_of(scene, case).drive.pose(times)
        # The lean of the blade is no part of its timing; the wheel's turn is.
        moved = pose[:, :2] if scene.name == 'excavation' else pose[:, [0, 2]]
        key = np.round(moved - moved[0], 9).tobytes()
        paths.setdefault(key, set()).add(splits.split_of(scene, case))
    assert all(len(of_path) == 1 for of_path in paths.values())


@SCENES
def test_what_the_record_does_not_hold_has_no_split(scene):
    assert splits.split_of(scene, f'{catalogue.TURNS[scene.name][0]}_9000') is None
    assert splits.split_of(scene, 'path_mine') is None
    held = set(splits.grid_runs(scene))
    other = next(case for case in range(1, scene.case_count + 1) if case not in held)
    assert splits.split_of(scene, other) is None
