"""Raw runs on disk: what is refused."""

import json

import numpy as np
import pytest

from mpm import raw_run
from mpm.run import RawRun


def test_what_is_no_manifest_is_refused(tmp_path):
    assert raw_run.read_manifest(str(tmp_path)) is None
    head = {'scene': {'name': 'wheel'}, 'dt': 0.1, 'bounds': []}
    entry = {'file': 'a.npz', 'bytes': 1, 'sha256': '', 'parameters': {}, 'case': 1}
    for content in (
        '{', '{"runs": []}', json.dumps(head | {'runs': [entry | {'file': '../a.npz'}]}),
        json.dumps(head | {'runs': [entry | {'case': None}]}),
    ):  # fmt: skip
        (tmp_path / 'manifest.json').write_text(content)
        with pytest.raises(ValueError, match='not a manifest'):
            raw_run.read_manifest(str(tmp_path))


@pytest.mark.parametrize(
    'wrong',
    [
        {'force': np.zeros((3, 3))}, {'pose': np.zeros((2, 6))},
        {'torque': np.full((2, 3), np.inf)}, {'positions': np.zeros((2, 12))},
        {'force': np.zeros((2, 3), int)}, {'parameters': 'null'},
    ],
    ids=str,
)  # fmt: skip
def test_what_is_no_run_is_refused(tmp_path, wrong):
    flat, cloud, path = np.zeros((2, 3)), np.zeros((2, 4, 3)), str(tmp_path / 'run_001.npz')
    good = {
        'positions': cloud, 'rigid_positions': cloud, 'force': flat, 'torque': flat,
        'pose': np.zeros((2, 7)), 'parameters': '{}',
    }  # fmt: skip
    np.savez(path, **good)
    assert isinstance(raw_run.read_run(path), RawRun)
    np.savez(path, **(good | wrong))
    with pytest.raises(ValueError, match='run_001.npz is not a raw run'):
        raw_run.read_run(path)
    (tmp_path / 'run_001.npz').write_bytes(b'version https://git-lfs')
    with pytest.raises(ValueError, match='not a raw run'):
        raw_run.read_run(path)
