"""Splits and order of the data of record."""

from collections import Counter

import pytest

from mpm import scenes, splits
from mpm.motions import catalogue

SCENES = pytest.mark.parametrize('scene', scenes.SCENES.values(), ids=lambda scene: scene.name)


def counts(scene, cases):
    return Counter(splits.split_of(scene, case) for case in cases)


@SCENES
def test_grid_is_whole_and_evenly_split(scene):
    cases = splits.grid_runs(scene)
    assert sorted(cases) == list(range(1, scene.case_count + 1))
    for split in ('test', 'valid'):
        part = [c for c in cases if splits.split_of(scene, c) == split]
        assert len(part) >= (25 if split == 'test' else 20)
        for name, values in scene.levels.items():
            used = Counter(scene.parameters(c)[name] for c in part)
            assert max(used[v] for v in values) - min(used[v] for v in values) <= 1, name
    assert splits.split_of(scene, scene.demo_case) == 'test'


def test_excavation_test_cases_meet_each_depth_with_each_speed():
    scene = scenes.EXCAVATION
    for split in ('test', 'valid'):
        part = [c for c in splits.grid_runs(scene) if splits.split_of(scene, c) == split]
        pairs = {tuple(list(scene.parameters(c).values())[:2]) for c in part}
        assert len(pairs) == len(part) == 25


def test_seeds_hold_what_is_asked():
    runs = splits.seed_runs(scenes.EXCAVATION)
    by_kind = Counter(catalogue.parse(scenes.EXCAVATION, c)[0] for c in runs)
    assert len(runs) >= 200 and min(by_kind[k] for k in ('lift', 'reverse', 'disturbed')) >= 50
    for kind in catalogue.TURNS['excavation']:
        found = counts(scenes.EXCAVATION, [c for c in runs if c.startswith(kind)])
        assert found['test'] == 10 and found['valid'] == 4
    halts = splits.halt_runs(scenes.EXCAVATION)
    assert counts(scenes.EXCAVATION, halts) == {'train': 12, 'valid': 4, 'test': 8}
    assert splits.split_of(scenes.EXCAVATION, 'halts_0024') is None
    runs = splits.seed_runs(scenes.WHEEL)
    found = counts(scenes.WHEEL, runs)
    assert len(runs) >= 120 and found['test'] >= 25 and found['valid'] >= 20


@SCENES
@pytest.mark.parametrize('order', [splits.seed_runs, splits.grid_runs])
@pytest.mark.parametrize('length', [40, 80, 150])
def test_any_beginning_is_in_proportion(scene, order, length):
    runs = order(scene)
    whole, part = counts(scene, runs), counts(scene, runs[:length])
    for split in splits.SPLITS:
        assert part[split] == pytest.approx(whole[split] * length / len(runs), abs=4.5), split
    if order is splits.seed_runs:
        kinds = Counter(catalogue.parse(scene, case)[0] for case in runs[:length])
        assert max(kinds.values()) - min(kinds.values()) <= 1


@SCENES
def test_what_the_record_does_not_hold_has_no_split(scene):
    runs = splits.seed_runs(scene)
    last = catalogue.parse(scene, runs[-1])[1]
    new = catalogue.select_seeds(scene, f'{last + 1}-{last + 20},9000-9009')
    assert counts(scene, new) == {None: 30}
    # The seed is known, but with another kind.
    kinds = catalogue.TURNS[scene.name]
    assert splits.split_of(scene, f'{kinds[0]}_0000') is not None
    assert splits.split_of(scene, f'{kinds[1]}_0000') is None
    assert splits.split_of(scene, 'path_mine') is None
