"""The recipes of the shipped models are what the folders of these models say."""

import json
import pathlib

import pytest

from learning_to_simulate import presets, shipped
from run_scripts import train_models

ROOT = pathlib.Path(__file__).resolve().parents[2]


def test_every_shipped_model_has_a_recipe():
    assert set(shipped.names()) <= set(train_models.SHIPPED)


@pytest.mark.parametrize('name', train_models.SHIPPED)
def test_a_network_was_trained_by_its_recipe(name):
    stored = json.loads((ROOT / 'models' / name / 'config.json').read_text())
    recipe = train_models.SHIPPED[name]
    config = presets.make_config(recipe.preset, **recipe.settings)
    assert type(config)(**stored['config']) == config
    if recipe.preset == 'soil_field':
        folders = stored['data']['path'].split(',')
        assert sorted(f.removeprefix('datasets/') for f in folders) == sorted(recipe.data)
        return
    runs = stored['data']['sha256']['train.tfrecord']
    manifest = (ROOT / 'datasets' / recipe.data[0] / 'manifest.json').read_text()
    assert (runs in manifest) == (not recipe.kinds)


def test_what_does_not_ship_is_refused(tmp_path):
    class Values:
        models, work_path = ['moon/pcg'], str(tmp_path)

    with pytest.raises(ValueError, match='no models .*moon/pcg.*; there are excavation/soil_field'):
        train_models.main(Values)
