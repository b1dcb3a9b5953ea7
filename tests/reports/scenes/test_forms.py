"""The report of forms: its tables, and a form that is refused."""

import json

import pytest

from learning_to_simulate.export import exporting
from learning_to_simulate.export_c import exporting as exporting_c
from reports.scenes import forms

ROW = {
    'c': {'ms_per_step': 0.0125, 'relative_difference': 1.5e-07},
    'tflite': {'ms_per_step': 0.05, 'relative_difference': 2.5e-07},
}


def test_tables_say_times_and_refusals(tmp_path):
    path = tmp_path / 'scene_forms.json'
    refused = ROW | {'c': {'refused': 'the C form knows one body'}}
    path.write_text(json.dumps({'rows': {'column': ROW, 'pair': refused}}))
    _, _, one, other = forms.table(str(path)).splitlines()
    assert one == '| `column` | 0.0125 | 0.05 | 1.5e-07 | 2.5e-07 |'
    assert other == '| `pair` | refused | 0.05 |  | 2.5e-07 |'
    _, _, only = forms.refusals(str(path)).splitlines()
    assert only == '| `pair` | C | the C form knows one body |'


def test_a_form_that_is_refused_says_why(monkeypatch, tmp_path):
    def refuse(*_):
        raise ValueError('the C form knows one body')

    monkeypatch.setattr(forms.report, 'make', lambda folder, name: type('D', (), {'path': 'x'}))
    monkeypatch.setattr(forms.lts, 'train', lambda *_: None)
    monkeypatch.setattr(exporting_c, 'export', refuse)
    monkeypatch.setattr(exporting, 'export', refuse)
    rows = forms.judge('pair', str(tmp_path), 1)
    assert rows == {kind: {'refused': 'the C form knows one body'} for kind in forms.FORMS}


def test_a_fault_is_no_refusal(monkeypatch, tmp_path):
    def fail(*_):
        raise OSError('disk full')

    monkeypatch.setattr(forms.report, 'make', lambda folder, name: type('D', (), {'path': 'x'}))
    monkeypatch.setattr(forms.lts, 'train', lambda *_: None)
    monkeypatch.setattr(exporting_c, 'export', fail)
    with pytest.raises(OSError, match='disk full'):
        forms.judge('pair', str(tmp_path), 1)
