"""Tables of runs that leave the data, from a document whose figures are known."""

import json

from reports import beyond

DOCUMENT = {'scenes': {'wheel': {
    'runs': [{'run': 'loose', 'reason': 'friction 0.3 is outside: of training', 'soil_mm': 2.0,
              'force_relative_l2': 0.5, 'flagged_share': 0.75}],
    'separation': {name: {'flagged_frames': 0.25, 'error_flagged': 0.6, 'error_inside': 0.2}
                   for name in ('test runs',)},
}}}  # fmt: skip


def test_tables_say_what_was_flagged_and_how_far_off_it_was(tmp_path):
    (tmp_path / 'known.json').write_text(json.dumps(DOCUMENT))
    path = str(tmp_path / 'known.json')
    assert '| wheel: loose | 2 | 0.5 | 75 | friction 0.3 is outside |' in beyond.table(path)
    assert '| wheel: test runs | 25 | 0.6 | 0.2 | 3 |' in beyond.separations(path)
