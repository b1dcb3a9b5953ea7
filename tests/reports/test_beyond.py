"""The tables of runs that leave the data."""

import json

from reports import beyond


def cells(line):
    return [cell.strip() for cell in line.strip('|').split('|')]


def test_a_wheel_forwards_and_backwards(tmp_path):
    ways = {
        'forwards': {key: [0.1, 0.2, 0.6] for key in beyond.ERRORS},
        'backwards': {key: [0.5, 0.5, 0.5] for key in beyond.ERRORS},
    }
    path = tmp_path / 'beyond.json'
    path.write_text(json.dumps({'ways': ways}))
    *_, forwards, backwards = beyond.ways(str(path)).splitlines()
    assert cells(forwards) == ['wheel, forwards (3 runs)', '0.3', '0.3', '0.2', '30']
    assert cells(backwards) == ['wheel, backwards (3 runs)', '0.5', '0.5', '0.5', '50']


def test_frames_that_are_flagged_beside_others(tmp_path):
    told = {'flagged_frames': 0.5, 'error_flagged': 0.6, 'error_inside': 0.2}
    of = {'test runs': {'flagged_frames': 0.0, 'error_inside': 0.2}, 'with those beyond': told}
    path = tmp_path / 'beyond.json'
    path.write_text(json.dumps({'scenes': {'wheel': {'separation': of}}}))
    *_, alone, both = beyond.separations(str(path)).splitlines()
    assert cells(alone) == ['wheel: test runs', '0', '', '0.2', '']
    assert cells(both) == ['wheel: with those beyond', '50', '0.6', '0.2', '3']
