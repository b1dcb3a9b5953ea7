"""Workers with real processes: killed ones, failing tasks, a dying scheduler, equal results."""

import os
import pathlib
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from pca_tools import decompose, subspace, workers
from tests.pca_tools import jobs

ROOT = pathlib.Path(__file__).resolve().parents[2]
KINDS = ['', 'local:2']


@pytest.fixture(params=KINDS, ids=['pool', 'dask'], scope='module')
def crew(request):
    """Two workers of each kind, shared by the tests that leave them whole."""
    if request.param:
        pytest.importorskip('distributed')
    with workers.start(request.param, 2) as started:
        yield started


def values(crew, function, inputs):
    outcomes = sorted(crew.run(function, inputs), key=lambda outcome: outcome.index)
    assert [outcome.index for outcome in outcomes] == list(range(len(inputs)))
    return outcomes


def test_every_input_is_run_once_by_several_processes(crew):
    found = [outcome.value for outcome in values(crew, jobs.who_and_square, range(12))]
    assert [square for _, square in found] == [n**2 for n in range(12)]
    pids = {pid for pid, _ in found}
    assert len(pids) == 2 and os.getpid() not in pids
    again = [outcome.value for outcome in values(crew, jobs.square, [3, 3, 3])]
    assert again == [9, 9, 9]  # equal inputs are tasks of their own


def test_what_fails_is_tried_again_and_does_not_stop_the_rest(crew, tmp_path):
    outcomes = values(crew, jobs.fails_at_first, [(n, str(tmp_path)) for n in range(5)])
    assert [o.value for o in outcomes] == [0, 1, None, 3, 4]
    assert outcomes[2].error == 'ValueError: never works'
    assert sorted(os.listdir(tmp_path)) == ['try0', 'try1', 'try2']


def test_covariance_on_workers_gives_the_same_subspace(crew, monkeypatch):
    rng = np.random.default_rng(0)
    shapes = rng.normal(size=(6, 60)) * 0.5 ** np.arange(6)[:, None]
    runs = jobs.Runs(
        np.einsum('tmk,mn->tnk', rng.normal(size=(20, 6, 3)), shapes) + 1.0 for _ in range(7)
    )
    monkeypatch.setattr(decompose, 'RUNS_PER_TASK', 2)
    memory = 2.5 * 8 * 60**2 / 2**20  # room for the covariance, not for the matrix
    plain = subspace.fit(runs, 4, max_memory_mb=memory)
    found = subspace.fit(runs, 4, max_memory_mb=memory, crew=crew)
    direct = subspace.fit(runs, 4)
    np.testing.assert_allclose(found.singular_values[:6], plain.singular_values[:6], rtol=1e-12)
    np.testing.assert_allclose(found.components, plain.components, atol=1e-12)
    np.testing.assert_allclose(found.singular_values[:4], direct.singular_values[:4], rtol=1e-9)


@pytest.mark.slow
def test_a_killed_worker_costs_its_task_only(tmp_path):
    pytest.importorskip('distributed')
    with workers.start('local:2') as crew:
        outcomes = values(crew, jobs.dies_once, [(n, str(tmp_path)) for n in range(8)])
    assert [o.value for o in outcomes] == [n**2 for n in range(8)]
    assert (tmp_path / 'died').exists()


@pytest.mark.slow
def test_a_worker_killed_in_the_middle_of_the_svd(monkeypatch, tmp_path):
    pytest.importorskip('distributed')
    rng = np.random.default_rng(0)
    runs = [rng.normal(size=(20, 60, 3)) + 1.0 for _ in range(9)]
    monkeypatch.setattr(decompose, 'RUNS_PER_TASK', 2)
    memory = 2.5 * 8 * 60**2 / 2**20
    plain = subspace.fit(jobs.Runs(runs), 6, max_memory_mb=memory)
    with workers.start('local:2') as crew:
        fatal = jobs.FatalRuns(runs, str(tmp_path))
        found = subspace.fit(fatal, 6, max_memory_mb=memory, crew=crew)
    assert (tmp_path / 'died').exists()
    np.testing.assert_allclose(found.singular_values, plain.singular_values, rtol=1e-12)
    np.testing.assert_allclose(found.components, plain.components, atol=1e-12)
    np.testing.assert_allclose(found.mean, plain.mean, atol=1e-12)


@pytest.mark.slow
def test_forty_solver_runs_with_a_killed_worker_are_those_of_one_process(tmp_path):
    pytest.importorskip('distributed')
    folders = [tmp_path / 'pool', tmp_path / 'dask']
    found = []
    for folder, where, fatal in zip(folders, ('', 'local:2'), (None, 7)):
        folder.mkdir()
        jobs.short_run((1, str(folder), 3, None))  # the packing, and the first run
        with workers.start(where, 1) as crew:
            inputs = [(case, str(folder), 3, fatal) for case in range(1, 41)]
            found.append([o.value[0] for o in values(crew, jobs.short_run, inputs)])
    assert (folders[1] / 'died').exists() and not (folders[0] / 'died').exists()
    assert found[0] == found[1] and len(set(found[0])) == 40
    names = [sorted(p.name for p in folder.glob('run_*.npz')) for folder in folders]
    assert names[0] == names[1] and len(names[0]) == 40


def test_a_pool_that_loses_a_process_says_so(tmp_path):
    with (
        pytest.raises(OSError, match='killed from outside'),
        workers.start('', 2) as crew,
    ):
        list(crew.run(jobs.dies_once, [(n, str(tmp_path)) for n in range(8)]))


@pytest.mark.slow
def test_a_killed_scheduler_and_the_command_given_again(tmp_path):
    """The command, its scheduler and workers go with SIGKILL; the second one makes the rest."""
    pytest.importorskip('distributed')
    code = """
import sys
from pca_tools import workers
from tests.pca_tools import jobs
if __name__ == '__main__':
    with workers.start('local:2') as crew:
        done = list(crew.run(jobs.write_file, [(n, sys.argv[1]) for n in range(8)]))
    print(sorted(outcome.value for outcome in done))
"""
    script = tmp_path / 'command.py'
    script.write_text(code)
    (tmp_path / 'out').mkdir()
    (tmp_path / 'out' / 'wait').touch()
    environment = os.environ | {'PYTHONPATH': str(ROOT)}
    command = [sys.executable, str(script), str(tmp_path / 'out')]
    first = subprocess.Popen(command, env=environment, cwd=ROOT, start_new_session=True)
    while len(list((tmp_path / 'out').glob('[0-9].npy'))) < 4:
        assert first.poll() is None
        time.sleep(0.1)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    (tmp_path / 'out' / 'wait').unlink()
    again = subprocess.run(
        command, env=environment, cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert again.stdout.strip() == str(sorted(['there'] * 4 + ['made'] * 4))
    for number in range(8):
        expected = np.random.default_rng(number).normal(size=100)
        np.testing.assert_array_equal(np.load(tmp_path / 'out' / f'{number}.npy'), expected)


def test_the_slurm_script_asks_for_one_thread_and_a_lifetime():
    pytest.importorskip('dask_jobqueue')
    with workers.slurm_cluster() as batch:
        script = batch.job_script()
    assert '#SBATCH -t 01:00:00' in script and '--lifetime 55m' in script
    assert '--nthreads 1' in script
    assert '-m distributed.cli.dask_worker tcp://' in script and '--memory-limit 3.73GiB' in script
    assert '--nworkers' not in script and script.startswith('#!/usr/bin/env bash')


@pytest.mark.parametrize('where', ['clowd', 'local:x', 'slurm:0'])
def test_unknown_words_are_refused(where):
    with pytest.raises(ValueError, match='cluster is'), workers.start(where):
        pass
