"""One model trained by two processes: the weights of one process, to round-off."""

import json
import os
import pathlib
import socket
import subprocess
import sys

import numpy as np
import pytest

from learning_to_simulate import presets, registry
from learning_to_simulate.full_space import data_parallel
from pca_tools import convert, files
from tests.pca_tools import synthetic

ROOT = pathlib.Path(__file__).resolve().parents[4]
SETTINGS = {
    'soil_particles': 60, 'latent_size': 8, 'message_passing_steps': 1, 'num_steps': 4,
    'batch_size': 4,
}  # fmt: skip


def free_ports(count):
    sockets = [socket.socket() for _ in range(count)]
    for each in sockets:
        each.bind(('127.0.0.1', 0))
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports


@pytest.mark.slow
def test_two_processes_train_the_model_of_one(tmp_path):
    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'excavation', range(1, 13))
    data = str(tmp_path / 'data')
    convert.convert(raw, data)
    for split in ('valid', 'test'):  # no validation rollout, which would have to be compiled
        os.remove(f'{data}/{split}.tfrecord')
    flags = [f'--set={name}={value}' for name, value in SETTINGS.items()]
    command = [sys.executable, '-m', 'learning_to_simulate.train', f'--data_path={data}',
               f'--model_path={tmp_path / "two"}', '--model=full_space', '--num_threads=1',
               '--save_every=2', *flags]  # fmt: skip
    workers = [f'127.0.0.1:{port}' for port in free_ports(2)]
    running = []
    for index in range(2):
        config = {'cluster': {'worker': workers}, 'task': {'type': 'worker', 'index': index}}
        environment = os.environ | {'TF_CONFIG': json.dumps(config)}
        running.append(subprocess.Popen(command, cwd=ROOT, env=environment))
    # Meanwhile alone, in this process.
    config = presets.make_config('full_space', **SETTINGS)
    registry.train(data, str(tmp_path / 'one'), config, save_every=4)
    assert [process.wait(timeout=600) for process in running] == [0, 0]
    one, chief, other = (
        files.read_npz(str(tmp_path / name / 'weights.npz'))
        for name in ('one', 'two', 'two.worker1')
    )
    for name, value in one.items():
        np.testing.assert_array_equal(chief[name], other[name])
        np.testing.assert_allclose(chief[name], value, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    'text',
    ['{', '[]', '{"cluster": {"worker": ["a:1", "b:1"]}, "task": {"index": 2}}',
     '{"cluster": {"worker": ["a:1"], "ps": ["c:1"]}}'],
)  # fmt: skip
def test_foreign_settings_are_refused(monkeypatch, text):
    monkeypatch.setenv('TF_CONFIG', text)
    with pytest.raises(ValueError, match='TF_CONFIG'):
        data_parallel.Share()


def test_alone_nothing_changes(monkeypatch):
    monkeypatch.delenv('TF_CONFIG', raising=False)
    share = data_parallel.Share()
    assert (share.index, share.count, share.folder('m')) == (0, 1, 'm')
    assert share.mean(('x',)) == ('x',)
    share.count = 2
    with pytest.raises(ValueError, match='multiple of 2'):
        share.refuse_batch(5)
