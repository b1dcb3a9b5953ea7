"""`python -m reports`: the list, the names, and the old commands."""

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
    with pytest.raises(SystemExit, match="no report 'moon'; there are results_table"):
        command.main(['moon'])


@pytest.mark.parametrize('name', command.REPORTS)
def test_every_name_has_a_module(name):
    assert importlib.util.find_spec(f'reports.{command.REPORTS[name][0]}')


def test_old_and_new_names_run_the_same_report(tmp_path):
    new = run('reports', 'results_table')
    assert new.returncode == 0 and '| pcg  ' in new.stdout
    assert run('run_scripts.results_table').stdout == new.stdout
    refused = run('reports', 'results_table', str(tmp_path))
    assert refused.returncode == 1 and 'metrics.json' in refused.stderr


def test_help_shows_the_flags_of_the_report_itself():
    text = run('reports', 'compare_forces', '--help').stdout
    assert '--original_path' in text and 'python -m reports compare_forces' in text


def test_no_report_needs_tensorflow_to_begin():
    """A fresh interpreter in which it cannot be imported: `--help` does not wait seconds for it."""
    modules = ', '.join(f'reports.{module}' for module, _ in command.REPORTS.values())
    code = f'import sys; sys.modules["tensorflow"] = None; import {modules}'
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f'a report imports TensorFlow at its top:\n{done.stderr}'
