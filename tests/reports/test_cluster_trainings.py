"""Trainings of reports on Dask workers: one killed in the middle ends with the serial weights."""

import json
import os
import pathlib
import signal
import threading
import time

import numpy as np
import pytest

from pca_tools import files, workers
from reports.protocol import rollouts
from tests.learning_to_simulate import synthetic

# The network that is compiled soonest; whatever is trained, it resumes from its checkpoints.
FLAGS = ['--preset=mlp', '--latent_size=4', '--num_steps=2000', '--save_every=50',
         '--set=unroll_steps=0', '--num_threads=1']  # fmt: skip


def kill_the_worker_of(model, killed):
    """Waits for the training's first checkpoint, then kills the worker that started it."""
    while not list(model.glob('ckpt-*.json')):
        time.sleep(0.05)
    training = json.loads((model / '.lock.json').read_text())['pid']
    stat = pathlib.Path(f'/proc/{training}/stat').read_text()
    worker = int(stat.rpartition(')')[2].split()[1])
    os.kill(worker, signal.SIGKILL)
    killed.append((worker, training))


@pytest.mark.slow
def test_a_worker_killed_in_the_middle_of_a_training(tmp_path):
    pytest.importorskip('distributed')
    data = str(synthetic.write_dataset(tmp_path / 'data'))
    for split in ('valid', 'test'):  # no validation rollout, which would have to be compiled
        os.remove(f'{data}/{split}.tfrecord')

    def job(name, seed):
        return data, str(tmp_path / name), [*FLAGS, f'--seed={seed}'], (), str(tmp_path)

    killed = []
    killer = threading.Thread(target=kill_the_worker_of, args=(tmp_path / 'a', killed))
    killer.daemon = True
    bad = (data, str(tmp_path / 'c'), ['--preset=none_of_that_name'], (), str(tmp_path))
    killer.start()
    with workers.start('local:2') as crew:
        outcomes = {o.index: o for o in crew.run(rollouts.make, [job('a', 0), bad])}
    assert killed and outcomes[0].error is None
    assert 'none_of_that_name' in outcomes[1].error  # reported, and the others are made
    rollouts.make(job('serial', 0))
    first, second = (files.read_npz(str(tmp_path / n / 'weights.npz')) for n in ('a', 'serial'))
    for name, value in first.items():
        np.testing.assert_array_equal(value, second[name])
