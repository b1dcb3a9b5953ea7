"""Raw runs on disk: what is refused."""

import numpy as np
import pytest

from mpm import raw_run
from mpm.run import RawRun


def test_what_is_no_manifest_is_refused(tmp_path):
    assert raw_run.read_manifest(str(tmp_path)) is None
    for content in ('{', '{"runs": []}'):
        (tmp_path / 'manifest.json').write_text(content)
        with pytest.raises(ValueError, match='manifest.json: is not a'):
            raw_run.read_manifest(str(tmp_path))


def test_what_is_no_run_is_refused(tmp_path):
    flat, cloud, path = np.zeros((2, 3)), np.zeros((2, 4, 3)), str(tmp_path / 'run_001.npz')
    good = {
        'positions': cloud, 'rigid_positions': cloud, 'force': flat, 'torque': flat,
        'pose': np.zeros((2, 7)), 'parameters': '{}',
    }  # fmt: skip
    np.savez(path, **good)
    assert isinstance(raw_run.read_run(path), RawRun)
    for wrong in ({'parameters': '{'}, {'unknown': flat}):
        np.savez(path, **(good | wrong))
        with pytest.raises(ValueError, match='run_001.npz is not a raw run'):
            raw_run.read_run(path)
    del good['pose']
    np.savez(path, **good)
    with pytest.raises(ValueError, match="is not a raw run: .*'pose'"):
        raw_run.read_run(path)
