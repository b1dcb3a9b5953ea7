"""The height map of a dataset, against the arrays of the raw runs."""

import shutil

import numpy as np
import pytest

from pca_tools import append, convert, files, heights, subset, write_raw
from pca_tools.inspect import OK, inspect_folder
from pca_tools.raw_runs import RawRuns
from tests.pca_tools import synthetic
from tests.pca_tools.synthetic import write_raw_folder

SHAPE, BIN = (5, 3), [0.8, 0.3, 0.6]
SPLITS = {5: 'valid', 6: 'test', 7: 'test'}


def surface(case, frames=24):
    """A furrow that deepens, float32 [T, 5, 3] m."""
    rng = np.random.default_rng(case)
    depth = np.cumsum(rng.uniform(0, 0.002, (frames, *SHAPE)), axis=0)
    return (0.4 - depth).astype(np.float32)


def raw_folder(folder, cases, name='excavation', without=(), **changes):
    """Raw runs with heights, but for those of the cases `without`."""

    def add(case, arrays):
        if case not in without:
            arrays['heights'] = surface(case)

    settings = {'split': lambda case: SPLITS.get(case, 'train'), 'bin_m': BIN} | changes
    return write_raw_folder(folder, name, cases, change=add, **settings)


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Raw runs 1 to 7 and the dataset of them; not to be changed."""
    folder = tmp_path_factory.mktemp('heights')
    raw = raw_folder(folder / 'raw', range(1, 8))
    convert.convert(raw, str(folder / 'data'), modes=5)
    return raw, str(folder / 'data')


def check(data, cases):
    """The maps of a dataset are those of the raw runs, to half a step."""
    for split, of_split in cases.items():
        maps = heights.read(data, split)
        assert len(maps) == len(of_split) and maps.frame_stride == 4
        np.testing.assert_allclose(maps.corner, [0.1, 0.1])
        np.testing.assert_allclose(maps.cell, [0.16, 0.2])
        for found, case in zip(maps, of_split, strict=True):
            assert found.shape == (6, *SHAPE)
            np.testing.assert_allclose(found, surface(case)[::4], rtol=0, atol=0.5e-4 + 1e-12)
    listed = files.check_manifest(data)
    assert {name for name in listed if 'heights' in name} == {f'heights_{s}.npz' for s in cases}


def test_maps_are_those_of_the_raw_runs(whole, tmp_path):
    raw, data = whole
    check(data, {'train': [1, 2, 3, 4], 'valid': [5], 'test': [6, 7]})
    told = [
        text for level, text in inspect_folder(data).findings if level == OK and 'height' in text
    ]
    low = min(surface(case)[20].min() for case in range(1, 8))  # the last frame that is kept
    high = max(surface(case)[0].max() for case in range(1, 8))
    assert len(told) == 1 and f'{low:.3f} to {high:.3f} m high, every 4 frames' in told[0]
    assert 'maps (5 x 3 cells of 160 x 200 mm from (0.1, 0.1) m' in told[0]
    new = raw_folder(tmp_path / 'new', (8, 9))
    convert.convert(new, str(tmp_path / 'like'), like=data)
    check(str(tmp_path / 'like'), {'train': [8, 9]})


def test_a_dataset_that_grew_equals_one_of_all_runs(whole, tmp_path):
    raw, data = whole
    part, grown = raw_folder(tmp_path / 'part', range(1, 7)), str(tmp_path / 'grown')
    convert.convert(part, grown, modes=5)
    after = append.append(raw, grown)  # of which it holds six
    assert after['dataset_split']['test'] == [6, 7]
    for split in ('train', 'valid', 'test'):
        one, other = (heights.Heights.path_of(folder, split) for folder in (grown, data))
        assert files.fingerprint(one) == files.fingerprint(other)
    other = write_raw_folder(
        tmp_path / 'other', 'excavation', (7, 8), split='test', bin_m=BIN,
        change=lambda case, arrays: arrays.update(heights=surface(case) - np.float32(0.001)),
    )  # fmt: skip
    with pytest.raises(ValueError, match='case 7 with other content'):
        append.append(other, grown)


def test_runs_without_a_map_or_with_another_one(whole, tmp_path):
    _, data = whole
    some = raw_folder(tmp_path / 'some', range(1, 6), without=(2, 4))
    with pytest.raises(ValueError) as error:
        convert.convert(some, str(tmp_path / 'out'))
    for text in (
        '2 faults',
        'run_002.npz: has',
        'True, None), the runs before',
        'run_004',
        'again',
    ):
        assert text in str(error.value), text
    for name, cells, changes in (
        ('none', 'none', {'without': (8,)}), ('bin', '5 x 3 cells', {'bin_m': [0.8, 0.3, 0.5]}),
    ):  # fmt: skip
        raw = raw_folder(tmp_path / name, (8,), **changes)
        with pytest.raises(ValueError, match=f'its height map is {cells}.*that of .*5 x 3 cells'):
            append.append(raw, shutil.copytree(data, tmp_path / f'{name}_data'))
    lost = shutil.copytree(data, tmp_path / 'lost')
    (lost / 'heights_train.npz').unlink()  # the manifest lists it
    with pytest.raises(FileNotFoundError, match='heights_train'):
        subset.subset(str(lost), str(tmp_path / 'few'), train_runs=2)
    raw = raw_folder(tmp_path / 'nowhere', (1, 2), bin_m=None)
    with pytest.raises(ValueError, match='do not say where the height map lies: heights_corner_m'):
        convert.convert(raw, str(tmp_path / 'out'))
    without = raw_folder(tmp_path / 'without', range(1, 6), without=range(1, 6))
    convert.convert(without, str(tmp_path / 'out'), modes=3)
    with pytest.raises(FileNotFoundError, match='holds no height map; convert it again'):
        heights.read(str(tmp_path / 'out'), 'train')
    assert not list((tmp_path / 'out').glob('heights*'))
    findings = inspect_folder(str(tmp_path / 'out')).findings
    assert not any('height map' in text for _, text in findings)


def own_runs(placed=True, **changes):
    """Two runs of a user, with the place of their maps."""
    places = {'heights_corner_m': [0.2, 0.3], 'heights_cell_m': [0.12, 0.14]} if placed else {}
    for case in (1, 2):
        made = synthetic.make_run('excavation', case)
        run = {name: made[name] for name in ('positions', 'rigid_positions', 'pose')}
        yield run | {'heights': surface(case), 'parameters': places, 'case': case} | changes


def test_own_raw_runs_have_their_heights_checked(tmp_path):
    raw, settings = str(tmp_path / 'raw'), {'dt': 1 / 60, 'up_axis': 'y'}
    tall = np.concatenate([surface(1), surface(1)], axis=1)
    bad = surface(1)
    bad[3, 2, 1] = np.nan
    for change, words in (
        ({'heights': tall[:, 0]}, r'heights has shape \(24, 3\), float32 for 24 frames of any x'),
        ({'heights': tall[:9]}, r'heights has shape \(9, 10, 3\)'),
        ({'heights': tall[:, :0]}, r'heights has shape \(24, 0, 3\)'),
        ({'heights': bad}, 'heights holds 1 NaN'),
        ({'heights': 1e3 * tall}, 'height map reaches 399.* m, .*are in metres'),
        ({'parameters': {'heights_corner_m': [0, 0]}}, 'where the height map lies'),
        ({'parameters': {'heights_corner_m': [0, 0], 'heights_cell_m': [0.1, 0]}}, 'where the'),
        ({'parameters': {'heights_corner_m': [0, 0], 'heights_cell_m': [120, 140]}}, 'in metres'),
        ({'placed': False}, 'where the height map lies'),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=words):
            write_raw(raw, own_runs(**change), **settings)
    first, second = own_runs()
    for other in (tall, None):
        with pytest.raises(ValueError, match=r'run 1: .* before it .*\(5, 3\), .*\(0.12, 0.14\)\)'):
            write_raw(raw, [first, second | {'heights': other}], **settings)
    write_raw(raw, own_runs(), **settings)
    run = RawRuns(raw)[1]
    np.testing.assert_array_equal(run.heights, surface(2))
    assert run.grid == heights.Grid((5, 3), (0.2, 0.3), (0.12, 0.14))
    convert.convert(raw, str(tmp_path / 'data'), modes=2, split=(1, 0, 0))
    maps = heights.read(str(tmp_path / 'data'), 'train')
    np.testing.assert_allclose(maps.corner, [0.2, 0.3])
    soil = first['positions'][:, :, :2]  # a run in the plane, whose map is two cells wide
    plane = {'positions': soil, 'heights': surface(1)[..., :2], 'parameters': first['parameters']}
    plane |= {'context': {'a': 1.0, 'b': 2.0}, 'step_context': np.ones((24, 2))}
    write_raw(str(tmp_path / 'plane'), [plane], **settings)
    run = RawRuns(str(tmp_path / 'plane'))[0]
    assert run.heights.shape == (24, 5, 2) and run.step_context.shape == (24, 2)
