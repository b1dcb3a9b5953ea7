"""Every package that is pinned has its licence listed."""

import csv
import pathlib
import re

ROOT = pathlib.Path(__file__).resolve().parents[1]


def normal(name):
    return re.sub('[-_.]+', '-', name.lower())


def test_every_pin_has_its_licence_listed():
    lines = (ROOT / 'constraints.txt').read_text().splitlines()
    pins = {normal(line.split('==')[0]) for line in lines if not line.startswith('#')}
    assert {'setuptools', 'pip', 'tensorflow', 'tensorflow-cpu', 'distributed'} <= pins
    with open(ROOT / 'licences.csv', encoding='utf-8') as file:
        listed = {normal(row['package']): row['licence'] for row in csv.DictReader(file)}
    assert pins <= set(listed) and all(listed.values())
    assert 'GPL' in listed['imageio-ffmpeg'] and 'NVIDIA' in listed['nvidia-cudnn-cu12']
