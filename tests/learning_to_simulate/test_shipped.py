"""Shipped models and datasets by name, from a folder that has none."""

import os
import pathlib

import pytest

from learning_to_simulate import shipped

ROOT = pathlib.Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    'name, kind, place',
    [
        ('excavation', 'models', 'excavation/soil_field'),
        ('wheel/pcg', 'models', 'wheel/pcg'),
        ('wheel', 'datasets', 'wheel'),
    ],
)
def test_name_means_a_folder(name, kind, place, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert shipped.find(name, kind) == str(ROOT / kind / place)


def test_a_path_goes_before_a_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.makedirs('wheel/soil_field')
    (tmp_path / 'wheel' / 'soil_field' / 'config.json').touch()
    assert shipped.find('./wheel/soil_field', 'models') == os.path.join('wheel', 'soil_field')
    assert shipped.find('wheel', 'models') == str(ROOT / 'models' / 'wheel' / 'soil_field')


def test_what_is_not_there_is_refused_with_what_is(tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match='moon: .*; shipped are .*excavation/pcg'):
        shipped.find('moon', 'models')
    names = (
        'excavation, excavation_beyond, excavation_long, excavation_more, excavation_wide, wheel, '
        'wheel_beyond, wheel_more'
    )
    with pytest.raises(FileNotFoundError, match=f'shipped are {names}$'):
        shipped.find('moon', 'datasets')
    monkeypatch.setattr(shipped, '_PACKAGE', str(tmp_path / 'package'))
    with pytest.raises(FileNotFoundError, match=r'pip install \.'):
        shipped.find('wheel', 'models')
