"""Files are written whole or not at all, and read only when they are what they claim."""

import os
import zipfile

import pytest

from pca_tools import command, files

POINTER = (
    b'version https://git-lfs.github.com/spec/v1\n'
    b'oid sha256:2ca3be6d46fd0dd60cbf5da1121a13dc3c847df3691b9cb9ca7c11b6080c88cf\n'
    b'size 190515362\n'
)


@pytest.mark.parametrize('read', [files.read_npz, files.read_json])
def test_pointer_empty_missing_and_folder_are_named(tmp_path, read):
    (tmp_path / 'pointer').write_bytes(POINTER)
    (tmp_path / 'empty').touch()
    for name, error, text in (
        ('pointer', ValueError, 'git-lfs pointer.*190515362 bytes.*git lfs pull'),
        ('empty', ValueError, 'is empty'),
        ('nowhere', FileNotFoundError, 'nowhere'),
        ('', ValueError, 'is a folder'),
    ):
        with pytest.raises(error, match=text):
            read(str(tmp_path / name))


def test_objects_and_members_that_are_no_arrays_are_refused(tmp_path):
    path = str(tmp_path / 'x.npz')
    with pytest.raises(ValueError, match='Python objects'):
        files.write_npz(path, evil=[object()])
    with zipfile.ZipFile(path, 'w') as archive:
        archive.writestr('../evil.sh', b'echo')
    with pytest.raises(ValueError, match='not a numpy array'):
        files.read_npz(path)


def test_manifest_notices_every_change(tmp_path):
    folder = str(tmp_path)
    assert files.check_manifest(folder) is None
    files.write_json(f'{folder}/a.json', [1, 2])
    files.write_manifest(folder, {'a.json': {'records': 3}})
    entries = files.check_manifest(folder)
    assert entries['a.json']['records'] == 3
    assert entries['a.json']['bytes'] == os.path.getsize(f'{folder}/a.json')
    with pytest.raises(ValueError, match='does not list b.json'):
        files.check_manifest(folder, ['b.json'])
    outside = {'files': {'../a': {'bytes': 1, 'sha256': 'x'}}}
    for name, content, text in (
        ('a', [1, 3], 'content differs from the manifest'),
        ('a', [1, 2, 3], 'the manifest says'),
        ('a', None, 'is missing'),
        ('manifest', outside, 'points out of the folder'),
        ('manifest', ['a'], 'is not a manifest'),
    ):
        files.write_json(f'{folder}/{name}.json', content)
        if content is None:
            os.remove(f'{folder}/{name}.json')
        with pytest.raises(ValueError, match=text):
            files.check_manifest(folder)


def test_large_json_is_refused_before_it_is_parsed(tmp_path):
    path = tmp_path / 'x.json'
    path.write_text('[' + '[],' * (files.MAX_JSON_BYTES // 3) + '[]]')
    with pytest.raises(ValueError, match='the limit of JSON files'):
        files.read_json(str(path))


def test_messages_cannot_control_a_terminal():
    assert command.printable('case \x1b[2J\x07 ü\nnext\t1') == 'case \\x1b[2J\\x07 ü\nnext\t1'
    assert command.printable('\u202eevil\x9b') == '\\u202eevil\\x9b'
    assert len(command.printable('x' * 30_000)) < 5000
