"""Training that is stopped, starved of disk, damaged or fed with NaN: nothing good is lost.

The compiled step is replaced by a cheap one that is a function of (weights, step), as the real one
is; that a real training killed by SIGKILL resumes bit for bit is held by
`tests/learning_to_simulate/test_train.py`.
"""

import contextlib
import os
import pathlib
import resource
import shutil
import signal

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate import presets, reading_utils, registry
from learning_to_simulate.subspace import method
from learning_to_simulate.subspace.trainer import Trainer
from learning_to_simulate.training import loop
from pca_tools import dataset, files
from pca_tools.storage import folder_lock, whole_files
from tests.faults.small import cheap_step
from tests.learning_to_simulate import synthetic

TINY = {'latent_size': 4, 'num_steps': 12, 'unroll_steps': 0, 'mode_edges': 5}


def config(**overrides):
    return presets.make_config('pcg', **TINY | overrides)


def step_with(number, action):
    """The cheap step, which does something more at one of them."""

    def step(self, i):
        if i == number:
            action()
        return cheap_step(self, i)

    return step


def interrupt(*_):
    raise KeyboardInterrupt


@contextlib.contextmanager
def files_up_to(size):
    """No file may grow above a size, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.fixture(scope='module')
def data(tmp_path_factory):
    folder = synthetic.write_dataset(tmp_path_factory.mktemp('data'))
    for split in ('valid', 'test'):  # no validation rollout, which would have to be compiled
        os.remove(f'{folder}/{split}.tfrecord')
    return folder


@pytest.fixture
def train(data, monkeypatch):
    monkeypatch.setattr(Trainer, 'step', cheap_step)

    def run(path, **overrides):
        return registry.train(data, str(path), config(**overrides), save_every=4)

    return run


@pytest.fixture(scope='module')
def whole(data, tmp_path_factory):
    """A model folder after training, with the checkpoints of steps 8 and 12. Not to be changed."""
    path = tmp_path_factory.mktemp('whole') / 'model'
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Trainer, 'step', cheap_step)
        registry.train(data, str(path), config(), save_every=4)
    return path


@pytest.fixture
def model(whole, tmp_path):
    return pathlib.Path(shutil.copytree(whole, tmp_path / 'model'))


def flip(path, position):
    data = bytearray(path.read_bytes())
    data[position] ^= 4
    path.write_bytes(data)


def weights(path):
    return files.read_npz(f'{path}/weights.npz')


def make_trainer(data):
    metadata = dataset.read_metadata(data)
    groups = reading_utils.read_groups(data, 'train', metadata, config().rigid_particles)
    return Trainer(method.make_model(data, metadata, groups, config()), groups)


def assert_same_weights(first, second):
    for name, value in weights(first).items():
        np.testing.assert_array_equal(value, weights(second)[name])


DAMAGES = {
    'truncated': lambda p: os.truncate(p / 'ckpt-12.npz', 1000),
    'empty': lambda p: os.truncate(p / 'ckpt-12.npz', 0),
    'bit flip': lambda p: flip(p / 'ckpt-12.npz', 2000),
    'bit flip at the end': lambda p: flip(p / 'ckpt-12.npz', -12),
}


@pytest.mark.parametrize('damage', DAMAGES.values(), ids=DAMAGES)
def test_damaged_newest_checkpoint_gives_way_to_the_one_before(whole, model, train, damage, capsys):
    damage(model)
    train(model)
    out = capsys.readouterr().out
    assert 'skipped the damaged checkpoint of step 12' in out
    assert f'resumed {model} at step 8' in out
    assert_same_weights(whole, model)
    assert loop.stored_steps(str(model)) == [12, 8]
    assert list(model.glob('ckpt-12.npz.damaged'))


def test_folder_of_damaged_checkpoints_only_never_starts_fresh(model, train):
    for step in (8, 12):
        os.truncate(model / f'ckpt-{step}.npz', 10)
    before = {p.name: p.read_bytes() for p in model.iterdir()}
    with pytest.raises(ValueError, match=r'all checkpoints are damaged.*ckpt-12.*ckpt-8'):
        train(model)
    assert {p.name: p.read_bytes() for p in model.iterdir()} == before


def test_checkpoint_of_another_model_is_refused(model, train, tmp_path):
    train(tmp_path / 'other', latent_size=6)
    shutil.copy(tmp_path / 'other' / 'ckpt-12.npz', model)
    with pytest.raises(ValueError, match='ckpt-12.npz: is a checkpoint of another model'):
        train(model)


def test_checkpoint_under_another_step_is_refused(model, train):
    (model / 'ckpt-8.npz').rename(model / 'ckpt-99.npz')
    with pytest.raises(ValueError, match='holds step 8, not that of its name'):
        train(model)


@pytest.mark.parametrize('number, code', [(signal.SIGTERM, 143), (signal.SIGINT, 130)], ids=str)
def test_stop_signals_save_and_release(whole, tmp_path, train, monkeypatch, number, code):
    before = signal.getsignal(number)
    with monkeypatch.context() as patch:
        patch.setattr(Trainer, 'step', step_with(5, lambda: os.kill(os.getpid(), number)))
        with pytest.raises(SystemExit) as stopped:
            train(tmp_path / 'model')
    assert stopped.value.code == code
    assert signal.getsignal(number) is before
    names = os.listdir(tmp_path / 'model')
    assert 'ckpt-6.npz' in names and '.lock.json' not in names
    train(tmp_path / 'model')
    assert_same_weights(whole, tmp_path / 'model')


@pytest.mark.parametrize('save_every', [4, 12], ids=['on the way', 'at the end'])
@pytest.mark.parametrize('writer', ['weights', 'checkpoint'])
def test_end_within_the_first_save_goes_on(whole, data, tmp_path, monkeypatch, save_every, writer):
    """Killed between weights and checkpoint: the weights alone were taken for a finished model."""
    path = str(tmp_path / 'model')
    place, name = {
        'weights': (loop.checkpoints, 'save_weights'),
        'checkpoint': (loop.TrainingState, 'save'),
    }[writer]
    monkeypatch.setattr(Trainer, 'step', cheap_step)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(place, name, interrupt)
        registry.train(data, path, config(), save_every=save_every)
    registry.train(data, path, config(), save_every=save_every)
    assert_same_weights(whole, path)


def test_second_ctrl_c_ends_at_once(tmp_path, train, monkeypatch):
    def twice():  # to this thread, so that each is handled before the next line
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Trainer, 'step', step_with(5, twice))
    # A shell starts background jobs with Ctrl-C ignored; 'as usual' is what a terminal has.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            train(tmp_path / 'model')
    finally:
        signal.signal(signal.SIGINT, before)
    assert loop.stored_steps(str(tmp_path / 'model')) == [4]
    assert not (tmp_path / 'model' / '.lock.json').exists()


@pytest.mark.parametrize('limit', [1000, 5000], ids='{} bytes a file'.format)
def test_full_disk_stops_training_and_keeps_the_checkpoint(tmp_path, train, monkeypatch, limit):
    with contextlib.ExitStack() as stack:
        fill = step_with(6, lambda: stack.enter_context(files_up_to(limit)))
        monkeypatch.setattr(Trainer, 'step', fill)
        with pytest.raises(OSError, match='model'):
            train(tmp_path / 'model')
    assert loop.stored_steps(str(tmp_path / 'model')) == [4]
    assert loop.newest(str(tmp_path / 'model'))[0] == 4
    assert not [n for n in os.listdir(tmp_path / 'model') if n.endswith('.tmp')]


def test_checkpoint_on_a_full_disk_says_so(model, data):
    """The checkpoint itself, without the weights that are written before it."""
    state = loop.TrainingState(str(model), make_trainer(data))
    state.restore()
    before = sorted(os.listdir(model))
    with (
        files_up_to(1000),
        pytest.raises(OSError, match='checkpoint of step 13 could not be written'),
    ):
        state.save(13)
    assert sorted(os.listdir(model)) == before


def test_leftovers_of_a_killed_writer_are_removed(model, train):
    hidden = os.path.basename(whole_files.temporary_beside(str(model / 'weights.npz')))
    (model / hidden).write_text('half')
    (model / 'notes.tmp').write_text('mine')
    train(model)
    names = os.listdir(model)
    assert hidden not in names
    assert 'notes.tmp' in names


def test_nan_loss_names_step_and_batch_and_keeps_the_last_good(tmp_path, train, monkeypatch):
    def step(self, i):
        values = cheap_step(self, i)
        if i >= 6:  # as a gradient of NaN leaves them
            for variable in self.simulator.trainable_variables:
                variable.assign(variable * np.nan)
            return {'loss': tf.constant(np.nan)}
        return values

    monkeypatch.setattr(Trainer, 'step', step)
    path = tmp_path / 'model'
    with pytest.raises(ValueError, match=r'loss is nan at step 6, batch .* \[\(\d+, \d+\), \('):
        train(path)
    assert loop.stored_steps(str(path)) == [4]
    assert all(np.isfinite(value).all() for value in weights(path).values())


@pytest.mark.parametrize('what', ['weight', 'moment', 'average'])
def test_variables_that_are_not_finite_are_never_saved(model, data, what):
    """Also where the loss that produced them was finite."""
    trainer = make_trainer(data)
    state = loop.TrainingState(str(model), trainer)
    state.restore()
    variable = {
        'weight': trainer.simulator.trainable_variables[0],
        'moment': trainer.optimizer.variables[-1],
        'average': trainer.averaging.variables[0],
    }[what]
    variable.assign(np.full(variable.shape, np.inf))
    before = sorted(os.listdir(model))
    with pytest.raises(ValueError, match='no checkpoint at step 13, variables are not finite'):
        state.save(13)
    assert sorted(os.listdir(model)) == before


def test_second_training_in_the_same_folder_is_refused(model, train):
    with folder_lock.locked(str(model)):
        before = {p.name: p.read_bytes() for p in model.iterdir()}
        with pytest.raises(ValueError, match=f'process {os.getpid()} on .* writes into this'):
            train(model)
        assert {p.name: p.read_bytes() for p in model.iterdir()} == before


def test_inputs_are_opened_for_reading_only(whole, data, tmp_path, train):
    """Nothing in the data folder is written, renamed or touched, whatever its permissions."""
    folder = tmp_path / 'data'
    shutil.copytree(data, folder)
    (folder / 'force.py').write_text('raise SystemExit("a data folder ran code")')
    (folder / 'sitecustomize.py').write_text('raise SystemExit("a data folder ran code")')
    before = {p.name: (p.read_bytes(), p.stat().st_mtime_ns) for p in folder.iterdir()}
    for path in (*folder.iterdir(), folder):
        path.chmod(0o555 if path.is_dir() else 0o444)
    registry.train(str(folder), str(tmp_path / 'model'), config(), save_every=12)
    assert_same_weights(whole, tmp_path / 'model')
    folder.chmod(0o755)
    assert before == {p.name: (p.read_bytes(), p.stat().st_mtime_ns) for p in folder.iterdir()}
