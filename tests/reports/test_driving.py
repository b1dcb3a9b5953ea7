"""The report on free driving: truncation against particles, tables against their JSON."""

from types import SimpleNamespace

import numpy as np

from pca_tools import files
from reports import driving

H, T, N, R = 6, 11, 40, 20


def test_truncation_is_what_the_modes_cut_off_the_particles():
    rng = np.random.default_rng(0)
    modes, _ = np.linalg.qr(rng.normal(size=(N, N)))
    runs, floors, wanted = [], [], []
    for scale in (1e-3, 2e-3):
        scores = scale * rng.normal(size=(T, N, 3)) * np.linspace(3, 0.1, N)[:, None]
        body = rng.normal(size=(T, 2, 3))
        record = np.concatenate([body, scores[:, :R]], axis=1)
        runs.append(SimpleNamespace(position=record, n_rigid=2, n_modes=R))
        particles = modes @ scores[H:]
        floors.append(((particles - modes[:, :R] @ scores[H:, :R]) ** 2).mean())
        cut = particles - modes[:, :8] @ scores[H:, :8]
        wanted.append(1e3 * np.sqrt((cut**2).mean()))
    found = driving.truncation_of(runs, floors, N)
    assert list(found) == [8, 16, R]
    np.testing.assert_allclose(found[8], wanted, rtol=1e-9)
    np.testing.assert_allclose(found[R], 1e3 * np.sqrt(floors), rtol=1e-9)


def _runs(*soil):
    return [{'soil_mm': mm, 'force_l2': mm / 10} for mm in soil]


def test_tables_are_means_by_kind_over_seeds(tmp_path):
    path = str(tmp_path / 'driving.json')
    seeds = [
        {'test': {'method': _runs(*mm), 'still': _runs(4.0, 6.0, 8.0)}}
        for mm in ((1.0, 3.0, 9.0), (3.0, 5.0, 7.0))
    ]
    document = {
        'truncation_mm': {'train': {'8': [1.0, 3.0]}, 'test': {'8': [4.0]}},
        'kinds': {'test': ['lift', 'stops', 'lift']},
        'methods': {'mine': seeds},
    }
    files.write_json(path, document)
    assert driving.modes(path).splitlines()[-1] == '| 8 | 2 | 4 |'
    header, _, still, mine = driving.methods(path, 'test').splitlines()
    assert header == '| soil, mm | lift (2) | stops (1) | all | better than still | force |'
    assert still == '| persistence | 6 | 6 | 6 | 0 of 3 | 0.6 |'
    assert mine == '| mine (2 seeds) | 5 | 4 (3 to 5) | 4.67 (4.33 to 5) | 2.5 (2 to 3) of 3 | ' \
        '0.467 (0.433 to 0.5) |'  # fmt: skip
