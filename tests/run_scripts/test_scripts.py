"""The scripts that people run, in miniature."""

import pathlib
import subprocess
import sys

import numpy as np
import pytest

from run_scripts import alternatives, demo, results_table, rollout_time
from tests.learning_to_simulate import synthetic

ROOT = pathlib.Path(__file__).resolve().parents[2]


def test_table_of_the_shipped_models_has_a_row_for_each(capsys):
    results_table.main([''])
    text = capsys.readouterr().out
    for name in ('excavation', 'wheel', 'pcg_thesis', 'fcg_original', '*stay still*'):
        assert name in text
    assert text.count('| pcg |') == 2


def test_table_of_a_folder_without_metrics_is_a_message(tmp_path):
    with pytest.raises(SystemExit, match='metrics.json'):
        results_table.main(['', str(tmp_path)])


def test_times_have_all_methods_in_one_run(tmp_path, monkeypatch):
    folder = synthetic.write_dataset(tmp_path)
    small = {'partial': {'preset': 'pcg', 'mode_edges': 5}, 'full': {'preset': 'fcg_original'}}
    for overrides in small.values():
        overrides['latent_size'] = 8
    monkeypatch.setattr(rollout_time, 'METHODS', small)
    rows = rollout_time.measure(folder, rounds=3)
    assert [row['edges'] for row in rows] == [4 * 3 + 5, 49, 49, 49]
    assert all(0 < row['ms_min'] <= row['ms_median'] <= row['ms_p95'] for row in rows)


def test_batches_repeat_the_test_runs_and_are_timed_per_run(tmp_path, monkeypatch):
    folder = synthetic.write_dataset(tmp_path)
    small = {'pcg': {'preset': 'pcg', 'mode_edges': 5, 'latent_size': 8}}
    monkeypatch.setattr(rollout_time, 'METHODS', small)
    rows = rollout_time.measure(folder, rounds=2, batch_sizes=[1, 3])  # the split holds 2 runs
    assert [(row['method'], row['batch']) for row in rows] == [('pcg, B = 1', 1), ('pcg, B = 3', 3)]
    with pytest.raises(ValueError, match=r'\[4, 0\], must be at least 1'):
        rollout_time.measure(folder, rounds=1, batch_sizes=[4, 0])


def test_alternatives_are_trained_and_tabulated(tmp_path):
    folder = synthetic.write_dataset(tmp_path / 'data')
    short = {'latent_size': 8, 'num_steps': 5, 'unroll_steps': 0, 'mode_edges': 5}
    rows = [alternatives.measure(folder, 'a -> b', short, str(tmp_path / 'work'))]
    text = alternatives.markdown(rows)
    assert 'a -> b' in text and 'nan' not in text
    assert np.isfinite(rows[0]['test']['soil_mse'])


def test_demo_table_leaves_out_what_a_row_lacks():
    text = demo.table('wheel', 7, [{'method': 'solver', 's per simulated s': 12.0}])
    title, _, row = text.splitlines()
    assert title == 'wheel, case 7' and row.split() == ['solver', '-', '-', '-', '-', '12', '-']


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [(['--scenes=moon'], 'unknown scene'), (['--cases=1,2', '--scenes=wheel'], '2 cases for 1')],
)
def test_demo_refuses_bad_choices_before_it_simulates(tmp_path, arguments, message):
    command = [sys.executable, '-m', 'run_scripts.demo', f'--output_path={tmp_path}', *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode != 0 and message in done.stderr and 'Traceback' not in done.stderr
    assert not list(tmp_path.iterdir())
