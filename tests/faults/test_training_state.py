"""Training that is stopped, starved of disk, damaged or fed with NaN: nothing good is lost.

The compiled step is replaced by a cheap one that is a function of (weights, step), as the real one
is.
"""

import contextlib
import functools
import os
import pathlib
import resource
import shutil
import signal

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate import checkpoints, presets, registry
from learning_to_simulate.subspace import trainer
from learning_to_simulate.training import loop
from pca_tools import files
from pca_tools.storage import folder_lock, whole_files
from tests.faults import small
from tests.faults.small import cheap_step


def step_with(number, action):
    """The cheap step, which does something more at one of them."""

    def step(self, i):
        if i == number:
            action()
        return cheap_step(self, i)

    return step


@contextlib.contextmanager
def files_up_to(size):
    """No file may grow above a size, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def train(path, save_every=4, **overrides):
    training = small.training(f'{small.world()}/data', num_steps=12, **overrides)
    loop.run(training, str(path), registry.TrainOptions(save_every=save_every))


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """A model folder after training, with the checkpoints of steps 8 and 12. Not to be changed."""
    path = tmp_path_factory.mktemp('whole') / 'model'
    train(path)
    return path


@pytest.fixture
def model(whole, tmp_path):
    return pathlib.Path(shutil.copytree(whole, tmp_path / 'model'))


def weights(path):
    return files.read_npz(f'{path}/weights.npz')


def contents(path):
    return {p.name: p.read_bytes() for p in path.iterdir()}


def assert_same_weights(first, second):
    for name, value in weights(first).items():
        np.testing.assert_array_equal(value, weights(second)[name])


def flip(path):
    data = bytearray(path.read_bytes())
    data[2000] ^= 4
    path.write_bytes(data)


@pytest.mark.parametrize('damage', [lambda path: os.truncate(path, 1000), flip])
def test_damaged_newest_checkpoint_gives_way_to_the_one_before(whole, model, damage, capsys):
    damage(model / 'ckpt-12.npz')
    train(model)
    out = capsys.readouterr().out
    assert 'skipped the damaged checkpoint of step 12' in out
    assert f'resumed {model} at step 8' in out
    assert_same_weights(whole, model)
    assert loop.stored_steps(str(model)) == [12, 8]
    assert list(model.glob('ckpt-12.npz.damaged'))


def test_folder_of_damaged_checkpoints_only_never_starts_fresh(model):
    for step in (8, 12):
        os.truncate(model / f'ckpt-{step}.npz', 10)
    before = contents(model)
    with pytest.raises(ValueError, match=r'all checkpoints are damaged.*ckpt-12.*ckpt-8'):
        train(model)
    assert contents(model) == before


def test_checkpoints_of_another_model_or_under_another_step_are_refused(model, tmp_path):
    train(tmp_path / 'other', latent_size=6)
    shutil.copy(tmp_path / 'other' / 'ckpt-12.npz', model)
    with pytest.raises(ValueError, match='ckpt-12.npz: is a checkpoint of another model'):
        train(model)
    (model / 'ckpt-8.npz').rename(model / 'ckpt-99.npz')
    with pytest.raises(ValueError, match='holds step 8, not that of its name'):
        train(model)


def test_stop_signals_save_and_release(whole, tmp_path, monkeypatch):
    """A training that is stopped twice, each time within a step, and then goes on to its end."""
    path = tmp_path / 'model'
    for step, number, code in ((5, signal.SIGTERM, 143), (9, signal.SIGINT, 130)):
        before = signal.getsignal(number)
        with monkeypatch.context() as patch, pytest.raises(SystemExit) as stopped:
            stop = functools.partial(os.kill, os.getpid(), number)
            patch.setattr(small.CheapTrainer, 'step', step_with(step, stop))
            train(path)
        assert stopped.value.code == code and signal.getsignal(number) is before
        assert loop.stored_steps(str(path))[0] == step + 1
        assert not (path / '.lock.json').exists()
    train(path)
    assert_same_weights(whole, path)


@pytest.mark.parametrize(
    'place, name, save_every', [(loop.TrainingState, 'save', 4), (checkpoints, 'save_weights', 12)]
)
def test_end_within_the_first_save_goes_on(whole, tmp_path, monkeypatch, place, name, save_every):
    """Weights without a checkpoint would be taken for a finished model; the checkpoint of the last
    step may be without weights."""

    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(place, name, interrupt)
        train(tmp_path / 'model', save_every)
    train(tmp_path / 'model', save_every)
    assert_same_weights(whole, tmp_path / 'model')


def test_second_ctrl_c_ends_at_once(tmp_path, monkeypatch):
    def twice():  # to this thread, so that each is handled before the next line
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(small.CheapTrainer, 'step', step_with(5, twice))
    # A shell starts background jobs with Ctrl-C ignored; 'as usual' is what a terminal has.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            train(tmp_path / 'model')
    finally:
        signal.signal(signal.SIGINT, before)
    assert loop.stored_steps(str(tmp_path / 'model')) == [4]
    assert not (tmp_path / 'model' / '.lock.json').exists()


def test_full_disk_stops_training_and_keeps_the_checkpoint(tmp_path, monkeypatch):
    with contextlib.ExitStack() as stack:
        fill = step_with(6, lambda: stack.enter_context(files_up_to(1000)))
        monkeypatch.setattr(small.CheapTrainer, 'step', fill)
        with pytest.raises(OSError, match='model'):
            train(tmp_path / 'model')
    assert loop.newest(str(tmp_path / 'model'))[0] == 4
    assert not [n for n in os.listdir(tmp_path / 'model') if n.endswith('.tmp')]


def test_what_cannot_be_saved_leaves_the_folder_as_it_was(model):
    """A checkpoint on a full disk, and variables that are not finite, though the loss was."""
    resumed = small.training(f'{small.world()}/data').trainer
    state = loop.TrainingState(str(model), resumed)
    state.restore()
    before = contents(model)
    with (
        files_up_to(1000),
        pytest.raises(OSError, match='checkpoint of step 13 could not be written'),
    ):
        state.save(13)
    for variable in (
        resumed.simulator.trainable_variables[0],
        resumed.optimizer.variables[-1],
        resumed.averaging.variables[0],
    ):
        good = variable.numpy()
        variable.assign(np.full(variable.shape, np.inf))
        with pytest.raises(ValueError, match='no checkpoint at step 13, variables are not finite'):
            state.save(13)
        variable.assign(good)
    assert contents(model) == before


def test_leftovers_of_a_killed_writer_are_removed(model):
    hidden = os.path.basename(whole_files.temporary_beside(str(model / 'weights.npz')))
    (model / hidden).write_text('half')
    (model / 'notes.tmp').write_text('mine')
    train(model)
    names = os.listdir(model)
    assert hidden not in names and 'notes.tmp' in names


def test_nan_loss_names_step_and_batch_and_keeps_the_last_good(tmp_path, monkeypatch):
    def step(self, i):
        values = cheap_step(self, i)
        if i >= 6:  # as a gradient of NaN leaves them
            for variable in self.simulator.trainable_variables:
                variable.assign(variable * np.nan)
            return {'loss': tf.constant(np.nan)}
        return values

    monkeypatch.setattr(small.CheapTrainer, 'step', step)
    path = tmp_path / 'model'
    with pytest.raises(ValueError, match=r'loss is nan at step 6, batch .* \[\(\d+, \d+\), \('):
        train(path)
    assert loop.stored_steps(str(path)) == [4]
    assert all(np.isfinite(value).all() for value in weights(path).values())


def test_second_training_in_the_same_folder_is_refused(model):
    with folder_lock.locked(str(model)):
        before = contents(model)
        with pytest.raises(ValueError, match=f'process {os.getpid()} on .* writes into this'):
            train(model)
        assert contents(model) == before


def test_inputs_are_opened_for_reading_only(tmp_path, monkeypatch):
    """Nothing in the data folder is written, renamed or touched, whatever its permissions."""
    folder = tmp_path / 'data'
    folder.mkdir()
    # No validation rollout, which would have to be compiled.
    small.copies('data', 'metadata.json', 'train.tfrecord', 'subspace.npz')(folder)
    for name in ('force.py', 'sitecustomize.py'):
        (folder / name).write_text('raise SystemExit("a data folder ran code")')
    before = contents(folder), [p.stat().st_mtime_ns for p in folder.iterdir()]
    for path in (*folder.iterdir(), folder):
        path.chmod(0o555 if path.is_dir() else 0o444)
    monkeypatch.setattr(trainer.Trainer, 'step', cheap_step)
    config = presets.make_config('pcg', **small.TINY)
    registry.train(str(folder), str(tmp_path / 'model'), config)
    folder.chmod(0o755)
    assert before == (contents(folder), [p.stat().st_mtime_ns for p in folder.iterdir()])
