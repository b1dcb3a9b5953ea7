"""Whole files and folders under attack: threads, links, long names, mounts, kills."""

import concurrent.futures
import contextlib
import functools
import os
import pathlib
import signal
import stat

import pytest

from pca_tools.storage import whole_files


def put(text):
    """A writer that leaves `text` in the file."""
    return lambda path: pathlib.Path(path).write_text(text)


def fill_with(text):
    return lambda folder: put(text)(os.path.join(folder, 'a'))


def test_threads_of_one_process_do_not_meet(tmp_path):
    """One temporary name for all of them made 136 of 300 writes fail."""

    def write(number):
        for _ in range(60):
            whole_files.write_atomically(str(tmp_path / 'x'), put(str(number) * 1000))

    with concurrent.futures.ThreadPoolExecutor(5) as pool:
        list(pool.map(write, range(5)))  # raises what one of them raised
    text = (tmp_path / 'x').read_text()
    assert len(text) == 1000 and len(set(text)) == 1
    assert os.listdir(tmp_path) == ['x']


@pytest.mark.parametrize('replace', [True, False])
def test_folder_writers_of_one_process_do_not_meet(tmp_path, replace):
    """A second writer with the same process id (another container) removed the first one's work.
    Where nothing is to be replaced both found the name free, and the faster one keeps it."""
    path = str(tmp_path / 'set')

    def outer(folder):
        fill_with('outer')(folder)
        whole_files.write_folder_atomically(path, fill_with('inner'), replace)
        assert os.listdir(folder) == ['a']

    with contextlib.nullcontext() if replace else pytest.raises(OSError):
        whole_files.write_folder_atomically(path, outer, replace)
    assert (tmp_path / 'set' / 'a').read_text() == ('outer' if replace else 'inner')
    assert os.listdir(tmp_path) == ['set']


def test_links_under_guessed_names_are_not_written_through(tmp_path):
    victim = tmp_path / 'victim'
    victim.write_text('precious')
    for name in (f'.x.{os.getpid()}.tmp', '.x.tmp', 'x.tmp'):
        (tmp_path / name).symlink_to(victim)
    whole_files.write_atomically(str(tmp_path / 'x'), put('new'))
    assert victim.read_text() == 'precious' and (tmp_path / 'x').read_text() == 'new'
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(os.stat(tmp_path / 'x').st_mode) == 0o666 & ~mask


def test_output_that_is_a_link_is_the_folder_it_means(tmp_path):
    (tmp_path / 'disk').mkdir()
    (tmp_path / 'out').symlink_to(tmp_path / 'disk')
    whole_files.write_folder_atomically(str(tmp_path / 'out'), fill_with('new'))
    assert (tmp_path / 'out').is_symlink() and (tmp_path / 'disk' / 'a').read_text() == 'new'
    (tmp_path / 'later').symlink_to(tmp_path / 'not_yet')
    whole_files.write_folder_atomically(str(tmp_path / 'later'), fill_with('new'))
    assert (tmp_path / 'not_yet' / 'a').read_text() == 'new'


def test_long_names_lose_nothing(tmp_path):
    name = 'n' * 255
    whole_files.write_folder_atomically(str(tmp_path / name), fill_with('new'))
    whole_files.write_atomically(str(tmp_path / name / name), put('new'))
    whole_files.write_folder_atomically(str(tmp_path / name), fill_with('newer'))
    assert os.listdir(tmp_path) == [name] and os.listdir(tmp_path / name) == ['a']


def test_impossible_names_are_told_before_the_work(tmp_path):
    def work(folder):
        raise AssertionError('the work was done for nothing')

    (tmp_path / 'file').write_text('')
    for name, error in (('n' * 256, OSError), ('file', NotADirectoryError), ('file/x', OSError)):
        with pytest.raises(error):
            whole_files.write_folder_atomically(str(tmp_path / name), work)
    with pytest.raises(OSError, match='name'):
        whole_files.write_atomically(str(tmp_path / ('n' * 256)), work)
    assert os.listdir(tmp_path) == ['file']


def test_mount_points_are_filled_in_place(tmp_path, monkeypatch):
    """A rename onto a mount point fails; here the system only says that it is one."""
    path = tmp_path / 'mount'
    path.mkdir()
    inode = path.stat().st_ino
    monkeypatch.setattr(whole_files.os.path, 'ismount', lambda p: str(p) == str(path))

    def fill(folder):
        for name in ('z', 'a', 'manifest.json'):
            put(name)(os.path.join(folder, name))

    whole_files.write_folder_atomically(str(path), fill)
    assert sorted(os.listdir(path)) == ['a', 'manifest.json', 'z']
    assert path.stat().st_ino == inode and os.listdir(tmp_path) == ['mount']
    with pytest.raises(OSError, match='mount point'):
        whole_files.write_folder_atomically(str(path), fill)


def killed_before(point, names, work):
    """Runs work in a process that gets SIGKILL right before its call number `point` of one of the
    named functions of `whole_files`; returns whether it was killed."""
    pid = os.fork()
    if pid:
        return os.WIFSIGNALED(os.waitpid(pid, 0)[1])
    try:
        calls = []

        def counted(real):
            def call(*arguments, **options):
                calls.append(real)
                if len(calls) == point:
                    os.kill(os.getpid(), signal.SIGKILL)
                return real(*arguments, **options)

            return call

        for name in names:
            *module, function = name.split('.')
            owner = getattr(whole_files, module[0]) if module else whole_files
            setattr(owner, function, counted(getattr(owner, function)))
        work()
    finally:
        os._exit(0)


@pytest.mark.parametrize('swaps', [True, False], ids=['exchange', 'two_renames'])
def test_kill_while_a_folder_is_replaced_leaves_a_whole_one(tmp_path, monkeypatch, swaps):
    """SIGKILL right before each system call that changes a name, one after the other."""
    if not swaps:
        monkeypatch.setattr(whole_files, '_swap', lambda *names: False)
    for point in range(1, 12):
        path = tmp_path / str(point) / 'set'
        whole_files.write_folder_atomically(str(path), fill_with('old'))
        write = functools.partial(whole_files.write_folder_atomically, str(path), fill_with('new'))
        names = ('os.rename', 'os.mkdir', 'shutil.rmtree', '_swap')
        was_killed = killed_before(point, names, write)
        if not swaps:  # else there is never a moment without a whole folder under the name
            whole_files.recover_folder(str(path))
        assert (path / 'a').read_text() in ('old', 'new')
        if not was_killed:
            break
    assert 3 < point < 11
    assert (path / 'a').read_text() == 'new'


def test_recovery_takes_only_what_a_writer_put_aside(tmp_path):
    path = tmp_path / 'set'
    (tmp_path / '.set.mine.old').mkdir()
    assert whole_files.recover_folder(str(path)) is None
    aside = pathlib.Path(whole_files.temporary_beside(str(path), '.old'))
    aside.mkdir()
    (aside / 'a').write_text('old')
    with pytest.raises(ValueError, match='set: is not empty; name another folder'):
        whole_files.write_folder_atomically(str(path), fill_with('new'), replace=False)
    assert (path / 'a').read_text() == 'old'  # back under its name, and not replaced
    assert (tmp_path / '.set.mine.old').is_dir()


def test_kill_while_results_are_replaced_never_mixes_them(tmp_path):
    """SIGKILL before each change of a name: `last` lies beside one whole set, or is absent."""

    def fill(fresh):
        for name in ('run_0', 'run_1', 'metrics'):
            put('new')(os.path.join(fresh, name))

    for point in range(1, 9):
        folder = tmp_path / str(point)
        folder.mkdir()
        for name in ('run_0', 'run_1', 'run_2', 'metrics', 'picture'):
            (folder / name).write_text('old')

        replace = functools.partial(
            whole_files.replace_files, str(folder), fill, lambda n: n.startswith('run_'), 'metrics'
        )
        was_killed = killed_before(point, ('os.mkdir', 'os.remove', 'os.replace'), replace)
        assert was_killed == (point <= 6)
        if (folder / 'metrics').exists():
            kept = {p.name: p.read_text() for p in folder.glob('[rm]*')}
            assert set(kept.values()) == {kept['metrics']}
            assert len(kept) == (4 if kept['metrics'] == 'old' else 3)
        replace()
        assert sorted(os.listdir(folder)) == ['metrics', 'picture', 'run_0', 'run_1']
        assert (folder / 'run_1').read_text() == 'new'


@pytest.mark.parametrize('value', [float('nan'), float('inf'), -float('inf')])
def test_a_number_that_json_does_not_have_is_refused_and_the_old_file_stays(tmp_path, value):
    path = tmp_path / 'a.json'
    path.write_text('old')
    with pytest.raises(ValueError, match=r'a\.json: cannot be written as JSON'):
        whole_files.write_json(str(path), {'a': [value]})
    assert path.read_text() == 'old'
    assert [file.name for file in tmp_path.iterdir()] == ['a.json']
