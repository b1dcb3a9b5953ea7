"""What is tried with driven tools, on a model whose soil and force are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout_status import RolloutStatus
from reports.stability import cases, driven_cases

N_FRAME = 80


class Model:
    """Soil that goes 1 mm a frame along x for `creeps` frames; force as high as the tool."""

    def __init__(self, creeps=10**6, bad=None):
        self.creeps, self.bad, self.paths = creeps, bad, []

    def rollout(self, path, context=None):
        self.paths.append((path, context))
        force = np.zeros((len(path) - 1, 3))
        force[:, 1] = path[1:, 1]
        statuses = [RolloutStatus.OK] * len(force)
        if self.bad is not None:
            force[-1], statuses[-1] = self.bad, RolloutStatus.EXTRAPOLATING

        def particles(frame):
            way = 1e-3 * min(range(len(force))[frame], self.creeps)
            return np.array([[way, 0.0, 0.0], [way, 0.0, 0.3]], np.float32)

        return SimpleNamespace(
            force=force, particles=particles, status=statuses[-1], frame_status=statuses
        )


@pytest.fixture
def run():
    poses = np.zeros((N_FRAME, 7))
    poses[:, 0] = np.arange(N_FRAME)
    poses[:, 1] = 2.0
    return {'poses': poses, 'context': poses[:, :1], 'way': 0.005}


def test_the_path_goes_to_and_fro_from_the_last_given_frame(run):
    model = Model()
    (row,) = driven_cases.driven_on('m', model, [run], 3)
    path, context = model.paths[0]
    length = 3 * (N_FRAME - H) + 1
    assert len(path) == len(context) == length
    np.testing.assert_array_equal(path[:, :1], context)  # the context goes with the frames
    assert path[0, 0] == H - 1 and path[:, 0].max() == N_FRAME - 1
    assert set(np.abs(np.diff(path[:, 0]))) == {1.0}
    # One axis of three moves.
    assert row.figure == pytest.approx(1e-3 * (length - 2) / np.sqrt(3) / 0.005)
    assert row.outcome == cases.HOLDS and '1 of 1 runs ok, 100 % of the frames' in row.note


def test_soil_that_creeps_under_a_tool_at_rest_is_told(run):
    model = Model(creeps=N_FRAME - H + 60 + 7)
    (row,) = driven_cases.held('m', model, [run], 3)
    path, _ = model.paths[0]
    assert set(path[N_FRAME - H :, 0]) == {N_FRAME - 1.0}
    assert row.figure == pytest.approx(7 / np.sqrt(3), rel=1e-4)


@pytest.mark.parametrize('bad, outcome', [(np.nan, cases.FAILS), (7.0, cases.FLAGGED)])
def test_a_force_that_is_no_number_fails_and_a_status_flags(run, bad, outcome):
    (row,) = driven_cases.driven_on('m', Model(bad=bad), [run], 2)
    assert row.outcome == outcome and '0 of 1 runs ok' in row.note


def test_the_ride_above_the_bed_is_level_and_clear_of_it(run):
    model = Model()
    (row,) = driven_cases.air('m', model, [run])
    path, _ = model.paths[-1]
    assert path[:, 1] == pytest.approx(driven_cases.AIR)  # the soil of this model lies at height 0
    assert path[0, 0] - path[-1, 0] == pytest.approx(driven_cases.AIR_WAY)
    assert row.figure == pytest.approx(driven_cases.AIR)


def test_faster_and_deeper_paths_keep_their_contexts(run):
    model = Model(bad=7.0)
    rows = driven_cases.beyond('m', model, run)
    (fast, context), (deep, _) = model.paths
    np.testing.assert_array_equal(fast[:, :1], context)
    assert set(np.diff(fast[:, 0])) == {float(driven_cases.FASTER)} and fast[0, 0] == H - 1
    assert deep[0, 1] == 2.0 and deep[-1, 1] == pytest.approx(2.0 - driven_cases.DEEPER)
    assert [row.outcome for row in rows] == 2 * [cases.FLAGGED]
    assert rows[0].figure < 100.0
    assert len(driven_cases.beyond('m', model, run, deeper=False)) == 1
