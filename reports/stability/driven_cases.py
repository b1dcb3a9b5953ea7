"""Driven tools beyond what models were shown: longer, stopped, in the air, faster, deeper."""

import os

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout_status import RolloutStatus
from pca_tools import dataset
from reports.record import ROOT
from reports.stability.cases import FAILS, FLAGGED, HOLDS, Case, hold, judged, to_and_fro

PART = 'Driven tools'
HORIZON = 10
MODELS = {
    'excavation_v2': ('swept_field', 'mlp_driven', 'pcg'),
    'wheel_v2': ('swept_field', 'pcg'),
}
# One test run of each of these kinds, the first there is; beds at rest that nothing has cut.
KINDS = ('smooth', 'stops', 'lift', 'slip', 'load', 'reverse')
FASTER, DEEPER = 3, 0.08  # times as fast, m below the path
AIR = 0.05  # m between the blade's edge and the bed
AIR_WAY, AIR_FRAMES = 0.3, 180  # m, frames of a level ride


def recorded_runs(data_path: str, n_run: int | None = None) -> list[dict]:
    """Test runs: `poses` float64 [T, 7], m, `context` [T, C] or None, `way` of the soil in m.

    The way is the farthest that the recorded soil gets from where it began, root mean square over
    particles and axes.
    """
    metadata = dataset.read_metadata(data_path)
    found: dict[str, dict] = {}
    cases = metadata['cases']['test']
    for case, run in zip(cases, dataset.read_split(data_path, 'test'), strict=True):
        if case['kind'] in KINDS and case['kind'] not in found and run.rigid_pose is not None:
            modes = run.position[:, run.n_rigid :].astype(np.float64)
            way = ((modes - modes[:1]) ** 2).sum(axis=(1, 2)).max()
            found[case['kind']] = {
                'poses': run.rigid_pose.astype(np.float64),
                'context': run.step_context,
                'way': float(np.sqrt(way / (3 * metadata['n_soil']))),
            }
    return list(found.values())[:n_run]


def rms(particles: np.ndarray) -> float:
    """Root mean square over particles and axes."""
    return float(np.sqrt((particles.astype(np.float64) ** 2).mean()))


def roll_out(model, runs: list[dict], frames: np.ndarray) -> list:
    """The rollouts of runs with their frames in another order, from the last given one on."""
    rollouts = []
    for run in runs:
        context = run['context']
        context = None if context is None else context[frames][H - 1 :]
        rollouts.append(model.rollout(run['poses'][frames][H - 1 :], context=context))
    return rollouts


def _outcome(rollouts):
    if not all(np.isfinite(r.force).all() for r in rollouts):
        return FAILS
    statuses = {r.status for r in rollouts}
    return HOLDS if statuses == {RolloutStatus.OK} else FLAGGED


def _statuses(rollouts):
    frames = [status for r in rollouts for status in r.frame_status]
    share = frames.count(RolloutStatus.OK) / len(frames)
    runs = sum(r.status == RolloutStatus.OK for r in rollouts)
    return f'{runs} of {len(rollouts)} runs ok, {100 * share:.0f} % of the frames'


def driven_on(name: str, model, runs: list[dict], factor: int) -> list[Case]:
    """The path to its end and back, again and again: how far the soil is at the end."""
    n_frame = len(runs[0]['poses'])
    frames = to_and_fro(n_frame, H + factor * (n_frame - H))
    rollouts = roll_out(model, runs, frames)
    ways = [
        rms(rollout.particles(-1) - rollout.particles(0)) / run['way']
        for rollout, run in zip(rollouts, runs, strict=True)
    ]
    force = max(np.linalg.norm(rollout.force, axis=1).max() for rollout in rollouts)
    note = f'worst {max(ways):.3g}, largest force {force:.3g} N; {_statuses(rollouts)}'
    what = f'{name}, path to and fro, {factor} x horizon: soil distance at the end over the true '
    figure, unit = float(np.median(ways)), '(median of the runs)'
    return [Case(PART, f'{what}largest', figure, unit, None, _outcome(rollouts), note)]


def held(name: str, model, runs: list[dict], factor: int) -> list[Case]:
    """The tool stops at the end of its path: what soil and force do from then on."""
    n_frame = len(runs[0]['poses'])
    frames = hold(n_frame, H + factor * (n_frame - H))
    rollouts = roll_out(model, runs, frames)
    stop = n_frame - H + 60  # a second after the stop, when true soil has come to rest
    creep = [1e3 * rms(r.particles(-1) - r.particles(stop)) for r in rollouts]
    change = [float(np.linalg.norm(r.force[-1] - r.force[stop])) for r in rollouts]
    seconds = (len(frames) - n_frame - 60) / 60
    note = f'worst {max(creep):.3g} mm; the force changes by {max(change):.3g} N at most; '
    what = f'{name}, tool held at its end: what the soil moves in {seconds:.0f} s of rest'
    return [
        judged(PART, what, float(np.median(creep)), 'mm', None, note + _statuses(rollouts)),
    ]


def air(name: str, model, runs: list[dict]) -> list[Case]:
    """A level ride of the blade above the bed: no force, and no soil that moves."""
    path = np.repeat(runs[0]['poses'][:1], AIR_FRAMES, axis=0)
    rest = model.rollout(path[:2]).particles(0)
    path[:, 1] = np.quantile(rest[:, 1], 0.999) + AIR
    path[:, 0] -= np.linspace(0.0, AIR_WAY, AIR_FRAMES)
    rollout = model.rollout(path)
    moved = 1e3 * rms(rollout.particles(-1) - rollout.particles(0))
    largest = float(np.linalg.norm(rollout.force, axis=1).max())
    what = f'{name}, {100 * AIR:.0f} cm above the bed: largest force'
    return [judged(PART, what, largest, 'N', None, f'soil moves by {moved:.3g} mm')]


def beyond(name: str, model, run: dict, deeper: bool = True) -> list[Case]:
    """A path that no training held: does the status say so?"""
    poses = run['poses'][H - 1 :]
    changed = {f'{FASTER} times as fast': (poses[::FASTER], FASTER)}
    if deeper:
        lower = poses.copy()
        lower[:, 1] -= np.linspace(0.0, DEEPER, len(poses))
        changed[f'ever deeper, {100 * DEEPER:.0f} cm at its end'] = lower, 1
    rows = []
    for what, (path, every) in changed.items():
        context = run['context']
        context = None if context is None else context[H - 1 :: every][: len(path)]
        rollout = model.rollout(path, context=context)
        share = 100 * np.mean([status == RolloutStatus.OK for status in rollout.frame_status])
        largest = float(np.linalg.norm(rollout.force, axis=1).max())
        tried = f'{name}, {what}: frames that are ok'
        note = f'{rollout.status}; largest force {largest:.3g} N'
        rows.append(Case(PART, tried, float(share), '%', None, _outcome([rollout]), note))
    return rows


def run_driven(is_quick, progress):
    """All rows; no curves."""
    import learning_to_simulate as lts

    rows: list[Case] = []
    jobs = [(data, model) for data, models in MODELS.items() for model in models]
    factor = 3 if is_quick else HORIZON
    for data, preset in progress(jobs[:1] if is_quick else jobs):
        runs = recorded_runs(os.path.join(ROOT, 'datasets', data), 1 if is_quick else None)
        name = f'{data}/{preset}'
        model = lts.load(os.path.join(ROOT, 'models', data, preset))
        is_blade = data.startswith('excavation')
        rows += driven_on(name, model, runs, factor) + held(name, model, runs, factor)
        rows += beyond(name, model, runs[0], is_blade)  # a wheel's height is not given
        if is_blade:
            rows += air(name, model, runs)
    return rows, {}
