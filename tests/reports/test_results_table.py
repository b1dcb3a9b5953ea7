"""The table of the shipped models."""

import glob
import os

import pytest

from reports import results_table
from reports.record import ROOT


def test_table_of_the_shipped_models_has_a_row_for_each(capsys):
    results_table.main(None, [])
    text = capsys.readouterr().out
    for name in ('excavation', 'wheel', 'pcg_thesis', 'fcg_original', '*persistence*'):
        assert name in text
    shipped = glob.glob(os.path.join(ROOT, 'models', '*', 'pcg'))
    assert text.count('| pcg  ') == len(shipped) > 0


def test_table_of_a_folder_without_metrics_is_a_message(tmp_path):
    with pytest.raises(FileNotFoundError, match='metrics.json'):
        results_table.main(None, [str(tmp_path)])
