"""Runs that leave the data; their tables are held by the documents."""

from types import SimpleNamespace

import numpy as np

from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.soil_field import evaluation
from pca_tools import dataset
from reports import beyond
from tests.learning_to_simulate.soil_field import worlds


def test_each_run_is_rolled_out_once_and_those_of_a_wheel_mirrored(monkeypatch):
    rolled = []

    def roll_out(_, run):
        """Right, but for runs that go backwards, whose force is twice the true one."""
        backwards = run.pose[-1, 0] > run.pose[0, 0]
        rolled.append(run.case)
        status = RolloutStatus.OK if run.case != 'far' else RolloutStatus.EXTRAPOLATING
        return SimpleNamespace(force=(1 + backwards) * run.force, frame_status=[status] * 49)

    def errors(rollout, run):
        off = np.linalg.norm(rollout.force - run.force) / np.linalg.norm(run.force)
        return dict.fromkeys((*beyond.ERRORS, 'soil_mm'), off) | {'status_reason': run.case}

    monkeypatch.setattr(evaluation.SoilEvaluator, 'roll_out', roll_out)
    monkeypatch.setattr(evaluation, 'of_rollout', errors)
    usual = [worlds.run(seed, case=str(seed)) for seed in (1, 2)]
    monkeypatch.setattr(beyond.runs_lib, 'read_all', lambda folders, split: usual)
    monkeypatch.setattr(beyond.runs_lib, 'read', lambda *_: [worlds.run(3, case='far')])
    cases = {'test': [{'case': 'far', 'plot': 'too deep'}]}
    monkeypatch.setattr(dataset, 'read_metadata', lambda _: {'cases': cases})
    found, ways = beyond.judged('wheel')
    assert rolled == ['1', '2', 'far', '1', '2']
    assert ways['forwards']['near_mm'] == [0.0, 0.0] and ways['backwards']['near_mm'] == [1.0, 1.0]
    (row,) = found['runs']
    assert (row['run'], row['reason'], row['soil_mm']) == ('too deep', 'far', 0.0)
    flagged = {name: of['flagged_frames'] for name, of in found['separation'].items()}
    assert flagged == {'test runs': 0.0, 'with those beyond': 0.3333}
    assert beyond.judged('excavation')[1] == {}
