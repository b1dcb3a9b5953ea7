"""Workers with real processes: killed ones, failing tasks, a dying scheduler, equal results."""

import os
import signal
import time

import numpy as np
import pytest

from pca_tools import subspace, workers
from tests.pca_tools import jobs
from tests.pca_tools.test_subspace import make_runs


@pytest.fixture(scope='module')
def dask():
    """Two workers of Dask, which starts a killed one anew."""
    pytest.importorskip('distributed')
    with workers.start('local:2') as started:
        yield started


@pytest.fixture(scope='module')
def pool():
    """Two workers of a pool; not to be killed."""
    with workers.start('', 2) as started:
        yield started


@pytest.fixture(params=['pool', 'dask'])
def crew(request):
    """Two workers of each kind."""
    return request.getfixturevalue(request.param)


def values(crew, function, inputs):
    outcomes = sorted(crew.run(function, inputs), key=lambda outcome: outcome.index)
    assert [outcome.index for outcome in outcomes] == list(range(len(inputs)))
    return outcomes


def test_every_input_is_run_once_by_several_processes(crew):
    found = [outcome.value for outcome in values(crew, jobs.who_and_square, range(12))]
    assert [square for _, square in found] == [n**2 for n in range(12)]
    pids = {pid for pid, _ in found}
    assert len(pids) == 2 and os.getpid() not in pids
    again = [outcome.value[1] for outcome in values(crew, jobs.who_and_square, [3, 3, 3])]
    assert again == [9, 9, 9]  # equal inputs are tasks of their own


def test_what_fails_is_tried_again_and_does_not_stop_the_rest(crew, tmp_path):
    outcomes = values(crew, jobs.fails_at_first, [(n, str(tmp_path)) for n in range(5)])
    assert [o.value for o in outcomes] == [0, 1, None, 3, 4]
    assert outcomes[2].error == 'ValueError: never works'
    assert sorted(os.listdir(tmp_path)) == ['try0', 'try1', 'try2']


def test_covariance_on_workers_gives_the_same_subspace(crew, monkeypatch):
    runs = make_runs(7, particles=60, rank=6)
    memory = 2.5 * 8 * 60**2 / 2**20  # of the covariance, but not of the matrix
    monkeypatch.setattr(subspace, 'RUNS_PER_TASK', 2)
    plain = subspace.fit(jobs.Runs(runs), 4, max_memory_mb=memory)
    found = subspace.fit(jobs.Runs(runs), 4, max_memory_mb=memory, crew=crew)
    direct = subspace.fit(runs, 4)
    np.testing.assert_allclose(found.singular_values[:6], plain.singular_values[:6], rtol=1e-12)
    np.testing.assert_allclose(found.components, plain.components, atol=1e-12)
    np.testing.assert_allclose(found.singular_values[:4], direct.singular_values[:4], rtol=1e-9)


def test_a_pool_that_loses_a_process_says_so(tmp_path):
    with (
        pytest.raises(OSError, match='killed from outside'),
        workers.start('', 2) as crew,
    ):
        list(crew.run(jobs.dies_once, [(n, str(tmp_path)) for n in range(8)]))


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


def test_a_killed_worker_costs_its_task_only(dask, tmp_path):
    outcomes = values(dask, jobs.dies_once, [(n, str(tmp_path)) for n in range(8)])
    assert [o.value for o in outcomes] == [n**2 for n in range(8)]
    assert (tmp_path / 'died').exists()


def test_what_has_come_stays_when_its_worker_dies(dask):
    outcomes = dask.run(jobs.who_and_square, range(6))
    first = next(outcomes).value
    while not all(dask.client.futures[key].status == 'finished' for key in dask.client.futures):
        time.sleep(0.05)
    time.sleep(0.5)  # all values are here
    os.kill(first[0], signal.SIGKILL)
    while all(state.status == 'finished' for state in dask.client.futures.values()):
        time.sleep(0.005)
    found = [first, *(outcome.value for outcome in outcomes)]
    assert sorted(square for _, square in found) == [n**2 for n in range(6)]
