"""Curves from what a training logs, their flatness, the table: on known events and errors."""

import pytest
import tensorflow as tf

from pca_tools import files
from reports import training_curve


def log(folder, rows):
    """Writes (step counted from 0, soil, force) as the training loop does, to a file of its own."""
    with tf.summary.create_file_writer(folder).as_default():
        for step, soil, force in rows:
            tf.summary.scalar('loss', 1.0, step=step)
            tf.summary.scalar('rollout_error_mse', soil, step=step)
            tf.summary.scalar('force_error_mse', force, step=step)


def test_a_curve_is_what_was_logged_last_at_each_step(tmp_path):
    folder = str(tmp_path)
    log(folder, [(9, 4.0, 1.0), (19, 3.0, 2.0)])
    log(folder, [(19, 2.5, float('nan')), (29, 2.0, 3.0)])  # killed after step 20, begun at 10
    assert training_curve.curve_of(folder) == [
        {'step': 10, 'soil_mse': 4.0, 'force_mse': 1.0},
        {'step': 20, 'soil_mse': 2.5, 'force_mse': None},
        {'step': 30, 'soil_mse': 2.0, 'force_mse': 3.0},
    ]


def test_flatness_compares_the_last_two_quarters():
    curve = [{'soil_mse': float(v), 'force_mse': None} for v in (90, 70, 50, 30, 10, 10, 4, 6)]
    assert training_curve.change(curve, 'soil_mse') == pytest.approx(0.5)
    assert training_curve.change(curve, 'force_mse') is None
    assert training_curve.change(curve[:7], 'soil_mse') == pytest.approx(0.4)  # quarters of one


def run(soil, mpe, l2=0.5):
    return {'soil_mse': soil, 'force_relative_l2': l2, 'force_mpe': mpe}


@pytest.fixture
def made(tmp_path, monkeypatch):
    """measure() of a training and a rollout that are left out; what they were called with."""
    called = []

    def train(data_path, model, given, shown):
        called.append((data_path, given, shown))
        log(model, [(9 + 10 * n, 8e-4 / (n + 1), 16.0) for n in range(4)])

    def roll_out(data_path, model, split, folder):
        runs = {
            'model': [run(1e-4, -20.0), run(5e-4, 10.0)],
            'stay_still': [run(2e-4, 50.0), run(4e-4, 50.0)],
            'constant_velocity': [run(3e-4, 9.0), run(3e-4, 9.0)],
        }
        files.write_json(f'{tmp_path}/metrics.json', {'runs': runs, 'split': split})
        return str(tmp_path)

    monkeypatch.setattr(training_curve.rollouts, 'train', train)
    monkeypatch.setattr(training_curve.rollouts, 'roll_out', roll_out)

    def measure(method):
        return training_curve.measure('sets/mine/', method, 'valid', str(tmp_path / 'work'))

    return measure, called


def test_a_row_holds_curve_and_runs_and_the_table_their_means(made, tmp_path):
    measure, called = made
    row = measure('fcg_original --num_steps=40 --save_every=10')
    flags = ['--preset=fcg_original', '--num_steps=40', '--save_every=10']
    assert called == [('sets/mine/', flags, True)]
    assert [p['step'] for p in row['curve']] == [10, 20, 30, 40]
    path = str(tmp_path / 'out.json')
    files.write_json(path, {'rows': {'a': row}})
    lines = [
        [cell.strip() for cell in line.split('|')[1:-1]]
        for line in training_curve.table(path).splitlines()
    ]
    assert lines[2][:2] == ['mine, valid, 2', '*persistence*'] and lines[2][4] == '3'
    # The model has the smaller error on the first run alone; its percentages are -20 and 10.
    assert lines[4] == ['mine, valid, 2', 'fcg_original', '40', '0.75, 1', '3', '3',
                        'wins 1 of 2', '0.5', '15']  # fmt: skip
    training_curve.draw(path, str(tmp_path / 'out.png'))
    assert (tmp_path / 'out.png').read_bytes()[:4] == b'\x89PNG'


def test_a_run_that_blew_up_wins_nowhere_and_has_no_mean(made, tmp_path):
    row = made[0]('fcg_original')
    row['runs']['model'][0] = run(None, None)
    path = str(tmp_path / 'out.json')
    files.write_json(path, {'rows': {'a': row}})
    line = training_curve.table(path).splitlines()[-1]
    assert 'not finite' in line and 'wins 0 of 2' in line
    row['runs']['model'][1] = run(None, None)
    row['curve'] = [point | {'soil_mse': None} for point in row['curve']]
    files.write_json(path, {'rows': {'a': row}})
    assert 'not finite |  | wins 0 of 2' in training_curve.table(path)
    training_curve.draw(path, str(tmp_path / 'out.png'))


def test_too_few_looks_are_refused(made, monkeypatch, tmp_path):
    monkeypatch.setattr(
        training_curve.rollouts, 'train', lambda _, model, *a, **k: log(model, [(9, 1.0, 1.0)])
    )
    with pytest.raises(ValueError, match='looked at 1 times'):
        made[0]('pcg_thesis')


def test_a_method_that_is_fitted_at_once_has_a_row_and_no_curve(made, monkeypatch, tmp_path):
    trained = made[0]('pcg_thesis')
    monkeypatch.setattr(training_curve.rollouts, 'train', lambda *a, **k: None)
    fitted = training_curve.measure('sets/other', 'path_ridge', 'valid', str(tmp_path / 'ridge'))
    assert fitted['curve'] == []
    path = str(tmp_path / 'out.json')
    files.write_json(path, {'rows': {'a': trained, 'b': fitted}})
    cells = [cell.strip() for cell in training_curve.table(path).splitlines()[-1].split('|')[1:-1]]
    assert cells[:4] == ['other, valid, 2', 'path_ridge', '', '']
    training_curve.draw(path, str(tmp_path / 'out.png'))
