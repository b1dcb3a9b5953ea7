"""Raw runs and datasets that several test files share, and the authors' folders."""

import os
import pathlib

import pytest

from pca_tools import convert
from tests.pca_tools import synthetic
from tests.pca_tools.commands import REPOSITORY


@pytest.fixture(scope='session')
def raw_excavation(tmp_path_factory):
    """Raw folder of 6 excavation runs."""
    folder = str(tmp_path_factory.mktemp('raw') / 'excavation')
    return synthetic.write_raw_folder(folder, 'excavation', range(1, 7))


@pytest.fixture(scope='session')
def raw_wheel(tmp_path_factory):
    """Raw folder of 6 wheel runs."""
    folder = str(tmp_path_factory.mktemp('raw') / 'wheel')
    return synthetic.write_raw_folder(folder, 'wheel', range(1, 7))


@pytest.fixture(scope='session')
def excavation(raw_excavation, tmp_path_factory):
    """Dataset of the excavation runs, centering `configuration`. Not to be changed."""
    folder = str(tmp_path_factory.mktemp('dataset') / 'excavation')
    convert.convert(raw_excavation, folder)
    return folder


@pytest.fixture(scope='session')
def wheel(raw_wheel, tmp_path_factory):
    """Dataset of the wheel runs, centering `scalar`, plain records. Not to be changed."""
    folder = str(tmp_path_factory.mktemp('dataset') / 'wheel')
    convert.convert(raw_wheel, folder, centering='scalar', packed=False)
    return folder


@pytest.fixture(params=['Excavation_PCA', 'Wheel_PCA'])
def original(request):
    """One of the authors' folders; they are not part of the project."""
    default = REPOSITORY.parent / 'shared' / 'original'
    folder = pathlib.Path(os.environ.get('ORIGINAL_DATA', default)) / request.param
    if not folder.is_dir():
        pytest.skip(f"{folder}: the authors' records are not there (set ORIGINAL_DATA)")
    return str(folder)
