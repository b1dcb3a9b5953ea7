import json

import pytest

from pca_tools.storage import text_files


def test_what_is_written_is_read_again_by_another_reader(tmp_path):
    path = tmp_path / 'a.json'
    content = {'text': 'depth 5 \N{GREEK SMALL LETTER MU}m', 'rows': [1.5, None, True]}
    for indent in (0, 2):
        text_files.write_json(str(path), content, indent)
        assert json.loads(path.read_bytes()) == content
        assert path.read_bytes().endswith(b'}\n')


@pytest.mark.parametrize('value', [float('nan'), float('inf'), -float('inf')])
def test_a_number_that_json_does_not_have_is_refused_and_the_old_file_stays(tmp_path, value):
    path = tmp_path / 'a.json'
    path.write_text('old')
    with pytest.raises(ValueError, match=r'a\.json: cannot be written as JSON'):
        text_files.write_json(str(path), {'a': [value]})
    assert path.read_text() == 'old'
    assert [file.name for file in tmp_path.iterdir()] == ['a.json']


def test_line_ends_stay_as_they_are(tmp_path):
    path = tmp_path / 'a.txt'
    text_files.write_text(str(path), 'a\nb\r\n')
    assert path.read_bytes() == b'a\nb\r\n'
