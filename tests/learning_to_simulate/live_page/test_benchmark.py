import importlib.util

import pytest

from learning_to_simulate.live_page import benchmark


def test_without_viser_it_says_what_to_install(monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, 'find_spec', lambda name, *rest: None if name == 'viser' else found(name)
    )
    with pytest.raises(ValueError, match=r'viser is not installed: pip install .*\[live\]'):
        benchmark.measure('excavation', 0.1, 8099)
