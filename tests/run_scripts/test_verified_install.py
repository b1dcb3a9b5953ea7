"""Pins, digests and licences: of all extras, and the same set in every list."""

import csv
import pathlib
import re

import pytest

from run_scripts import verified_install

ROOT = pathlib.Path(__file__).resolve().parents[2]


def normal(name):
    return re.sub('[-_.]+', '-', name.lower())


def pins():
    lines = (ROOT / 'constraints.txt').read_text().splitlines()
    pairs = (line.split('==') for line in lines if line and not line.startswith('#'))
    return {normal(name): version for name, version in pairs}


def hashed():
    lines = (ROOT / 'hashes.txt').read_text().splitlines()[1:]
    return {normal(line.split('==')[0]): line for line in lines}


def test_every_pin_has_a_digest_and_every_digest_its_pin():
    found, lines = pins(), hashed()
    assert {'setuptools', 'wheel', 'pip', 'tensorflow', 'tensorflow-cpu', 'distributed'} <= set(
        found
    )
    assert set(lines) == set(found)
    for name, line in lines.items():
        assert f'=={found[name]} ' in line
        assert re.fullmatch(r'\S+( --hash=sha256:[0-9a-f]{64})+  # [\w, ]+', line), line


def test_an_extra_chooses_what_it_needs():
    text = (ROOT / 'hashes.txt').read_text()
    names = [
        line.split('==')[0] for line in verified_install.chosen_lines(text, ['cpu', 'cluster'])
    ]
    assert {'tensorflow-cpu', 'distributed', 'numpy', 'pip', 'graph-nets'} <= set(names)
    assert not {'tensorflow', 'vtk', 'nvidia-cudnn-cu12'} & set(names)
    every = verified_install.chosen_lines(text, verified_install.extras())
    assert len(every) == len(hashed())
    with pytest.raises(ValueError, match=r"no extras \['gnu'\]"):
        verified_install.chosen_lines(text, ['gnu'])


def test_extras_are_those_of_setup():
    text = (ROOT / 'setup.py').read_text()
    assert "'cpu': ['tensorflow-cpu" in text
    assert verified_install.extras()[:2] == ['cpu', 'gpu']
    assert 'cluster' in verified_install.extras() and len(verified_install.extras()) >= 8


def test_every_package_has_its_licence_listed():
    with open(ROOT / 'licences.csv', encoding='utf-8') as file:
        listed = {normal(row['package']): row['licence'] for row in csv.DictReader(file)}
    assert set(hashed()) <= set(listed)
    assert all(listed.values())
    assert 'GPL' in listed['imageio-ffmpeg'] and 'NVIDIA' in listed['nvidia-cudnn-cu12']
