"""Numbers in documents have a file: tables agree with the JSON, the JSON with its runs."""

import json
import pathlib

import pytest

from reports.protocol import documents, tables

ROOT = pathlib.Path(__file__).resolve().parents[3]
PAGES = [ROOT / 'README.md', *sorted((ROOT / 'docs').rglob('*.md'))]
STORED = sorted((ROOT / 'docs' / 'protocol').glob('*.json'))


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_tables_are_what_the_json_says(page):
    assert documents.differences(str(page)) == []


@pytest.mark.parametrize('path', STORED, ids=lambda path: path.name)
def test_figures_follow_from_the_errors_of_the_runs(path):
    document = json.loads(path.read_text(encoding='utf-8'))
    assert tables.complete(document) == document
    assert {'command', 'commit', 'machine'} <= document['record'].keys()
    for method in document['methods']:
        for seed in method['seeds']:
            for split, runs in document['runs'].items():
                assert len(seed['runs'][split]) == len(runs)


def test_the_protocol_has_a_page_of_its_own():
    text = (ROOT / 'docs' / 'protocol.md').read_text(encoding='utf-8')
    assert STORED and all(f'<!-- protocol: protocol/{path.name} test' in text for path in STORED)
