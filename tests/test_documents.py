"""The documents: tables are those of their JSON, links lead somewhere, commands exist, the site
builds."""

import dataclasses
import functools
import importlib.util
import pathlib
import re
import shutil

import pytest
import yaml

from learning_to_simulate import cli, presets
from learning_to_simulate.native import web_page
from nri.config import NriConfig
from reports import __main__ as reports
from reports import documents
from run_scripts import site

ROOT = pathlib.Path(__file__).resolve().parents[1]
NAMES = documents.names()
# Figures of the solver and of tests: held by `mpm.verify` and the tests themselves.
OWN_FIGURES = ('mpm/', 'tests/')


def text_of(name):
    return (ROOT / name).read_text(encoding='utf-8')


def unnamed_tables(text):
    """First lines of the tables with measured numbers before which nothing says their origin."""
    for block in re.split(r'\n\s*\n', text):
        lines = block.strip().splitlines()
        table = [line for line in lines if line.startswith('|')]
        if table and re.search(r'\d\.\d', '\n'.join(table[2:])):
            before = lines[: lines.index(table[0])]
            if not any(x.startswith(('<!-- table: ', '<!-- no record: ')) for x in before):
                yield table[0]


@pytest.mark.parametrize('name', NAMES)
def test_tables_are_what_their_json_says_and_links_lead_somewhere(name):
    text = text_of(name)
    assert documents.render(text) == text, f'{name}: run `python -m reports documents`'
    if not name.startswith(OWN_FIGURES):
        assert not list(unnamed_tables(text))
    for target, anchor in re.findall(r'\]\(([^)#\s]*)(#[\w-]+)?\)', text):
        path = (ROOT / name).parent / target if target else ROOT / name
        if target.startswith(('http', 'mailto:')):
            continue
        assert path.exists(), f'{name}: {target} is not there'
        if anchor and not name.startswith(OWN_FIGURES):
            heads = re.findall(r'^#+ (.*)$', path.read_text(encoding='utf-8'), re.M)
            made = {re.sub(r'[^\w -]', '', head).lower().replace(' ', '-') for head in heads}
            assert anchor[1:] in made, f'{name}: {target} has no heading {anchor}'


def test_the_guard_sees_what_it_guards():
    assert list(unnamed_tables('text\n\n| a |\n|---|\n| 1.5 |\n')) == ['| a |']
    assert not list(unnamed_tables('<!-- no record: why -->\n| a |\n|---|\n| 1.5 |\n'))
    with pytest.raises(ValueError, match=r'<!-- table: reports.markdown:table a -->'):
        documents.render('<!-- table: reports.markdown:table a -->\n| a |\n|---|\n')
    named = '<!-- table: reports.protocol.tables:shipped docs/protocol/wheel.json -->'
    made = documents.render(f'{named}\n| wrong |\n\nafter\n')
    assert 'wrong' not in made and made.endswith(' |\n\nafter\n')
    assert documents.render(made) == made


@functools.cache
def known_flags():
    """Names of all flags that the sources define."""
    configs = *presets.PRESETS.values(), NriConfig()  # whose fields have flags
    names = {'help'} | {f.name for c in configs for f in dataclasses.fields(c)}
    for path in ROOT.glob('[!.]*/**/*.py'):
        names |= set(re.findall(r"DEFINE_\w+\(\s*'(\w+)'", path.read_text(encoding='utf-8')))
    return names | {f'no{name}' for name in names}


@pytest.mark.parametrize('name', NAMES)
def test_commands_and_flags_exist(name):
    blocks = re.findall(r'^```(\w*)\n(.*?)^```$', text_of(name), re.S | re.M)
    lines = [
        line.partition('#')[0]
        for language, block in blocks
        for line in block.replace('\\\n', ' ').splitlines()
        if not language and re.search(r'^lts |^python -m (?!venv)|run_scripts', line)
    ]
    for line in lines:
        for program in re.findall(r'^lts ([a-z]\S*)', line):
            assert program in cli.COMMANDS, f'no command lts {program}'
        for module, report in re.findall(r'python -m (\S+)(?: ([a-z]\w*))?', line):
            assert importlib.util.find_spec(module), f'no module {module}'
            assert module != 'reports' or report in {'', *reports.REPORTS}, f'no report {report}'
        assert not set(re.findall(r'--(\w+)', line)) - known_flags(), line
    assert lines or name not in ('README.md', 'docs/guide.md', 'docs/data.md')


def test_the_site_holds_every_page_and_is_built_without_warnings(tmp_path, monkeypatch):
    listed_by = yaml.safe_load(text_of('mkdocs.yml'))
    listed = {page for entry in listed_by['nav'] for page in entry.values()}
    assert listed == {path.name for path in (ROOT / 'docs').glob('*.md')}
    pytest.importorskip('zensical')
    # Copies: the site is built beside the file that a link of `mkdocs.yml` would lead to.
    shutil.copytree(ROOT / 'docs', tmp_path / 'docs', ignore=shutil.ignore_patterns('*.html'))
    shutil.copy(ROOT / 'mkdocs.yml', tmp_path)
    asked = []

    def export(model, path, data):
        asked.append((model, data))
        pathlib.Path(path).write_text('a page', encoding='utf-8')

    monkeypatch.setattr(web_page, 'export', export)
    built = site.build(tmp_path)
    assert (built / 'index.html').is_file()
    # The frame of the page on native code shows what was written.
    text = (built / 'native/index.html').read_text(encoding='utf-8')
    frame = re.search(r'<iframe src="([^"]*)"', text)[1]
    assert (built / 'native' / frame).read_text(encoding='utf-8') == 'a page'
    assert asked == [('excavation', 'datasets/excavation')]
    monkeypatch.setattr(web_page, 'export', lambda *_: (tmp_path / 'docs/blade.html').unlink())
    with pytest.raises(ValueError, match=r'native/index.html shows ../blade.html, which is not'):
        site.build(tmp_path)
