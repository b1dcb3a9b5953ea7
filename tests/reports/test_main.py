"""`python -m reports`: the list and the names."""

import importlib.util
import pathlib
import subprocess
import sys

import pytest

from reports import __main__ as command

ROOT = pathlib.Path(__file__).resolve().parents[2]


def run(*arguments):
    return subprocess.run(
        [sys.executable, '-m', *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )


def test_without_a_name_all_reports_are_listed(capsys):
    command.main([])
    text = capsys.readouterr().out
    assert all(f'  {name} ' in text for name in command.REPORTS)


def test_an_unknown_name_is_a_message():
    with pytest.raises(SystemExit, match="no report 'moon'; there are protocol"):
        command.main(['moon'])


@pytest.mark.parametrize('name', command.REPORTS)
def test_every_name_has_a_module(name):
    assert importlib.util.find_spec(f'reports.{command.REPORTS[name][0]}')


def test_bad_input_is_a_message_and_an_exit_code(tmp_path):
    refused = run('reports', 'documents', str(tmp_path / 'none.md'))
    assert refused.returncode == 1 and 'none.md' in refused.stderr
    assert 'Traceback' not in refused.stderr


def test_help_shows_the_flags_of_the_report_itself():
    text = run('reports', 'paper_tables', '--help').stdout
    assert '--models_path' in text and 'python -m reports paper_tables' in text


def test_no_report_needs_tensorflow_to_begin():
    """A fresh interpreter in which it cannot be imported: `--help` does not wait seconds for it."""
    modules = ', '.join(f'reports.{module}' for module, _ in command.REPORTS.values())
    code = f'import sys; sys.modules["tensorflow"] = None; import {modules}'
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f'a report imports TensorFlow at its top:\n{done.stderr}'
