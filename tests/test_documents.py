"""The documents: numbers are those of their records, links lead somewhere, the site builds."""

import pathlib
import re
import shutil
import subprocess
import sys

import pytest
import yaml

from pca_tools import files
from reports import documents
from reports.edges import edge_ablation_report
from reports.stability import cases

ROOT = pathlib.Path(__file__).resolve().parents[1]
NAMES = documents.names()
# Written whole by a report: how, again, from the record beside them.
WHOLE = {
    f'docs/edges/{name}.md': (
        lambda path: edge_ablation_report.table(files.read_json(str(path.with_suffix('.json'))))
    )
    for name in ('excavation', 'excavation_long', 'wheel')
}
# Written whole by reports that are no longer here; they stand as they were at the tag evidence-0.2.
FROZEN = {f'docs/error_vs_runtime/{scene}/table.md' for scene in ('excavation', 'wheel')}
# Written whole, of records that lie elsewhere or are made new by a long report: tables in them are
# compared where they have a record, or carry the command.
BY_COMMAND = {'docs/paper_tables.md', 'docs/stability/stability.md'}
OWN_RECORDS = ('mpm/', 'tests/', 'CHANGELOG')  # of the solver: by `mpm.verify` and the tests


@pytest.mark.parametrize('name', NAMES)
def test_tables_are_what_their_json_says(name):
    text = (ROOT / name).read_text(encoding='utf-8')
    assert documents.render(text) == text, f'{name}: run `python -m reports documents`'


@pytest.mark.parametrize('name', WHOLE)
def test_files_of_a_report_are_what_its_json_says(name):
    path = ROOT / name
    assert path.read_text(encoding='utf-8').strip() == WHOLE[name](path).strip()


def test_stability_table_is_what_its_json_says():
    rows = files.read_json(str(ROOT / 'docs/stability/stability.json'))['rows']
    table = cases.markdown([cases.Case(**row) for row in rows])
    assert table in (ROOT / 'docs/stability/stability.md').read_text(encoding='utf-8')


def unnamed_tables(text):
    """First lines of the tables with measured numbers before which nothing says their origin."""
    for block in re.split(r'\n\s*\n', text):
        lines = block.strip().splitlines()
        table = [line for line in lines if line.startswith('|')]
        if table and re.search(r'\d\.\d', '\n'.join(table[2:])):
            before = lines[: lines.index(table[0])]
            if not any(x.startswith(('<!-- table: ', '<!-- no record: ')) for x in before):
                yield table[0]


@pytest.mark.parametrize(
    'name',
    [n for n in NAMES if n not in {*WHOLE, *FROZEN, *BY_COMMAND} and not n.startswith(OWN_RECORDS)],
)
def test_tables_with_measured_numbers_name_their_record(name):
    assert not list(unnamed_tables((ROOT / name).read_text(encoding='utf-8')))


def test_the_guard_sees_what_it_guards():
    assert list(unnamed_tables('text\n\n| a |\n|---|\n| 1.5 |\n')) == ['| a |']
    assert not list(unnamed_tables('<!-- no record: why -->\n| a |\n|---|\n| 1.5 |\n'))
    text = '<!-- table: reports.markdown:table a -->\n| a |\n|---|\n'
    with pytest.raises(ValueError, match=r'<!-- table: reports.markdown:table a -->'):
        documents.render(text)
    named = '<!-- table: reports.protocol.tables:facts docs/protocol/wheel.json -->'
    text = f'{named}\n| wrong |\n\nafter\n'
    made = documents.render(text)
    assert 'wrong' not in made and made.endswith(' |\n\nafter\n')
    assert documents.render(made) == made


@pytest.mark.parametrize('name', NAMES)
def test_links_and_pictures_are_there(name):
    path = ROOT / name
    for target in re.findall(r'\]\(([^)#\s]+)[^)]*\)', path.read_text(encoding='utf-8')):
        if not target.startswith(('http', 'mailto:')):
            assert (path.parent / target).exists(), f'{name}: {target} is not there'


def pages(entries):
    for entry in entries:
        values = entry.values() if isinstance(entry, dict) else [entry]
        for value in values:
            yield from pages(value) if isinstance(value, list) else [value]


def test_every_page_of_the_site_is_there_and_every_guide_is_in_it():
    site = yaml.safe_load((ROOT / 'mkdocs.yml').read_text(encoding='utf-8'))
    listed = list(pages(site['nav']))
    assert all((ROOT / 'docs' / page).is_file() for page in listed)
    assert {path.name for path in (ROOT / 'docs').glob('*.md')} <= set(listed)


def test_the_site_is_built_without_warnings(tmp_path):
    pytest.importorskip('zensical')
    # Copies: the site is built beside the file that a link of `mkdocs.yml` would lead to.
    shutil.copytree(ROOT / 'docs', tmp_path / 'docs')
    shutil.copy(ROOT / 'mkdocs.yml', tmp_path)
    done = subprocess.run(
        [sys.executable, '-m', 'zensical', 'build', '--strict'],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / 'build/site/index.html').is_file()


def test_the_citation_is_whole():
    cited = yaml.safe_load((ROOT / 'CITATION.cff').read_text(encoding='utf-8'))
    assert {'cff-version', 'message', 'title', 'authors'} <= cited.keys()
    assert len(cited['references']) == 3
