"""`python -m reports`: the list and the names."""

import subprocess
import sys

import pytest

from reports import __main__ as command
from tests.pca_tools.commands import REPOSITORY, call_command


def test_without_a_name_all_reports_are_listed_and_an_unknown_one_is_a_message(capsys):
    command.main([])
    text = capsys.readouterr().out
    assert all(f'  {name} ' in text for name in command.REPORTS)
    with pytest.raises(SystemExit, match="no report 'moon'; there are protocol"):
        command.main(['moon'])


def test_bad_input_and_a_question_for_help_are_answered_by_the_report_itself(tmp_path):
    refused = call_command('reports', 'documents', str(tmp_path / 'none.md'))
    assert refused.returncode == 1 and 'none.md' in refused.stderr
    assert 'Traceback' not in refused.stderr
    text = call_command('reports', 'protocol', '--help').stdout
    assert '--work_path' in text and 'python -m reports protocol' in text


def test_every_report_is_there_and_needs_no_tensorflow_to_begin():
    """A fresh interpreter in which it cannot be imported: `--help` does not wait seconds for it."""
    modules = ', '.join(f'reports.{module}' for module, _ in command.REPORTS.values())
    code = f'import sys; sys.modules["tensorflow"] = None; import {modules}'
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f'a report imports TensorFlow at its top:\n{done.stderr}'
