"""The datasets and models that ship with the project are what their tables say."""

import json
import pathlib

import numpy as np
import pytest

from learning_to_simulate import evaluation, presets, reading_utils, registry, shipped
from learning_to_simulate.subspace import edge_lists
from pca_tools import dataset

ROOT = pathlib.Path(__file__).resolve().parents[1]
# Error of the soil in the subspace over that of the best trivial predictor, and relative L2 of the
# force, of the graph network on the validation split. Measured 0.26 / 0.62 and 0.56 / 0.19 when it
# was trained; these are the promised bounds.
PROMISED = {'excavation': (1 / 2, 0.75), 'wheel': (3 / 4, 0.25)}
# Models in the subspace, those of published methods trained on the grid runs of their dataset.
WHOLE = ('excavation/mlp_driven', 'excavation/pcg', 'wheel/pcg')
OF_GRID = ('excavation/fcg_original', 'excavation/pcg_thesis')


@pytest.mark.xla
@pytest.mark.parametrize('scene', PROMISED)
def test_graph_network_keeps_its_promise(scene):
    """Rolled out here and now, and equal to the table that ships beside the weights."""
    folder = ROOT / 'models' / scene / 'pcg'
    opened = registry.open_model(str(folder), str(ROOT / 'datasets' / scene), 'valid')
    model, metadata, groups = opened.model, opened.metadata, opened.groups
    _, summary = evaluation.Evaluator(model, metadata).run(groups, 'valid')
    mean = summary['mean']['model']
    soil, force = PROMISED[scene]
    assert summary['soil_mse_over_best_trivial'] <= soil
    assert mean['force_relative_l2'] <= force
    shipped = json.loads((folder / 'metrics.json').read_text())['mean']['model']
    # Float32 sums in another order, over 315 steps that do not forget: 1e-4 seen between machines
    # of one kind, so a hundred times that.
    for key in ('soil_mse', 'force_relative_l2', 'rigid_mse'):
        assert mean[key] == pytest.approx(shipped[key], rel=1e-2, abs=1e-12), key


@pytest.mark.parametrize('name', shipped.names())
def test_model_folders_are_small(name):
    assert sum(p.stat().st_size for p in (ROOT / 'models' / name).iterdir()) < 2 * 2**20


@pytest.mark.parametrize('name', WHOLE + OF_GRID)
def test_model_belongs_to_its_dataset(name):
    config = json.loads((ROOT / 'models' / name / 'config.json').read_text())
    data = ROOT / 'datasets' / name.split('/')[0]
    metadata = dataset.read_metadata(str(data))
    assert config['data']['subspace'] == metadata['pca']['digest']
    assert not config['data']['path'].startswith('/'), 'names a machine'
    manifest = (data / 'manifest.json').read_text()
    for digest in config['data']['sha256'].values() if name in WHOLE else ():
        assert digest in manifest


@pytest.mark.parametrize('scene', PROMISED)
def test_edges_of_the_graph_network_are_those_that_its_data_give(scene):
    folder, config = str(ROOT / 'datasets' / scene), presets.make_config('pcg', modes=8)
    groups = reading_utils.read_groups(
        folder, 'train', dataset.read_metadata(folder), **config.nodes
    )
    velocities = [g.velocity[:, :, g.n_rigid :] for g in groups]
    chosen = edge_lists.choose(config, folder, 8, velocities)
    stored = json.loads((ROOT / 'models' / scene / 'pcg' / 'config.json').read_text())
    assert chosen.mode_mask.astype(int).tolist() == stored['mode_mask']


@pytest.mark.parametrize(
    'names',
    [
        ('excavation', 'excavation_more'),
        ('excavation_wide',),
        ('excavation_long',),
        ('wheel', 'wheel_more'),
    ],
)
def test_no_case_is_in_two_splits(names):
    from mpm import scenes

    every = [dataset.read_metadata(str(ROOT / 'datasets' / name)) for name in names]
    metadata = every[0]
    runs = [run for of in every for cases in of['cases'].values() for run in cases]
    assert len({run['case'] for run in runs}) == len(runs)
    levels = scenes.SCENES[metadata['scene']['name']].levels
    for run in runs:
        if run['kind'] == 'grid':
            assert all(run[name] in values for name, values in levels.items()), run['case']


def test_records_hold_what_the_solver_recorded():
    """Blade points of the grid's records move as the scene prescribes, to float32."""
    from mpm.motions import grid

    metadata = dataset.read_metadata(str(ROOT / 'datasets' / 'excavation'))
    runs = dataset.read_split(str(ROOT / 'datasets' / 'excavation'), 'test')
    times = np.arange(321) * metadata['dt']
    pairs = [p for p in zip(runs, metadata['cases']['test'], strict=True) if p[1]['kind'] == 'grid']
    assert len(pairs) == 6
    for run, case in pairs:
        expected = grid.blade_displacement(
            case['motion'], case['depth_m'], case['speed_m_s'], times
        )
        moved = (run.position[:, 0] - run.position[0, 0])[:, :2]
        np.testing.assert_allclose(moved, expected, atol=2e-7)
