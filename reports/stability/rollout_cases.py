"""Long rollouts of the shipped models: ten times the horizon, error growth, rest, rigid shape."""

import dataclasses

import numpy as np

from learning_to_simulate import metrics
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout_status import RolloutStatus
from reports.stability import shipped as lib
from reports.stability.cases import FLAGGED, HOLDS, Case, judged

PART = 'Long rollouts'
HORIZON = 10
CONTINUATIONS = {'to and fro': lib.to_and_fro, 'held at its end': lib.hold}
# Every this many frames of a long rollout are kept for the pictures.
STRIDE = 10


def given_body(model) -> bool:
    """Whether the motion of the body is (in part) given."""
    return model.model.simulator.scene.rigid_motion.is_known


def long_rollout(model, function, factor, continuation):
    """Rolls all test runs out over `factor` times the horizon.

    Returns:
      row and curve: RMS distance of the soil from its first frame, median over runs; the same for
      constant velocity.
    """
    group = model.group
    n_frame = group.position.shape[1]
    length = H + factor * (n_frame - H)
    longer = lib.resample(group, CONTINUATIONS[continuation](n_frame, length))
    position, _, judgements = lib.roll(model, function, longer)
    modes = position[:, :, group.n_rigid :]
    start = group.position[:, H - 1 : H, group.n_rigid :]
    distance = model.soil_rms(modes - start)
    trivial = model.soil_rms(lib.constant_velocity(group, modes.shape[1]) - start)
    # The farthest that the soil of any test run really moves within the data.
    true_distance = model.soil_rms(group.position[:, H:, group.n_rigid :] - start).max()
    statuses = [judgement.status for judgement in judgements]
    lost = [j.frame for j in judgements if j.status in ('left_bounds', 'non_finite')]
    kind = HOLDS if set(statuses) == {RolloutStatus.OK} else FLAGGED
    body = f'body {continuation}' if given_body(model) else 'body predicted'
    row = Case(
        PART,
        f'{model.name}, {body}, {factor} x horizon: soil distance at the end over the true largest',
        float(np.median(distance[:, -1]) / true_distance),
        '(median of the runs)',
        None,
        kind,
        f'{lib.worst(judgements)}; x {np.median(trivial[:, -1]) / true_distance:.3g} for constant '
        f'velocity, 0 for persistence',
    )
    keep = slice(None, None, STRIDE)
    curve = {
        'model': model.name,
        'continuation': continuation,
        'frames': np.arange(H, length)[keep],
        'distance_mm': 1e3 * np.median(distance, axis=0)[keep],
        'constant_velocity_mm': 1e3 * np.median(trivial, axis=0)[keep],
        'status': [str(status) for status in statuses],
        'time_to_failure_s': min(lost) * model.model.simulator.scene.dt if lost else None,
    }
    return row, curve


def error_growth(model, rolled):
    """Row of the error at the end over the best trivial predictor's there, and the curve of the
    soil error over the data, RMS over runs, beside the trivial predictors, mm."""
    group = model.group
    truth = group.position[:, H:, group.n_rigid :]
    methods = {
        'mm': rolled[:, :, group.n_rigid :],
        'persistence_mm': group.position[:, H - 1 : H, group.n_rigid :],
        'constant_velocity_mm': lib.constant_velocity(group, truth.shape[1]),
    }
    curve = {
        name: 1e3 * np.sqrt((model.soil_rms(modes - truth) ** 2).mean(axis=0))
        for name, modes in methods.items()
    }
    own, *trivial = (values[-1] for values in curve.values())
    half = curve['mm'][truth.shape[1] // 2]
    note = f'{own:.3g} mm at the end of the data, {half:.3g} mm half way; persistence '
    note += f'{trivial[0]:.3g}, constant velocity {trivial[1]:.3g} mm'
    name = f'{model.name}: error at the end of the data over that of the best trivial predictor'
    row = judged(PART, name, float(own / min(trivial)), '', None, note)
    frames = np.arange(H, group.position.shape[1])
    return row, {'model': model.name, 'frames': frames} | curve


def rest(model, function):
    """Row of a scene at rest: how far the soil drifts when nothing moves, per frame."""
    group = model.group
    n_frame = group.position.shape[1] - H
    still = dataclasses.replace(
        group,
        position=np.repeat(group.position[:, :1], H + n_frame, axis=1),
        force=None,
        body=None,
    )
    position, _, judgements = lib.roll(model, function, still)
    modes = position[:, :, group.n_rigid :]
    drift = model.soil_rms(modes[:, -1] - modes[:, 0]).max() / (n_frame - 1)
    truth = model.group.velocity[:, :, group.n_rigid :]
    usual = np.sqrt((model.soil_rms(truth) ** 2).mean())
    return judged(
        PART,
        f'{model.name}: drift per frame of soil and body at rest over the RMS motion of the data',
        float(drift / usual),
        '',
        None,
        f'over {n_frame} frames; {lib.worst(judgements)}',
    )


def rigid_shape(model):
    """Rows of a predicted body with and without its correction."""
    group = model.group

    def edges(body):
        return np.linalg.norm(body[..., :, None, :] - body[..., None, :, :], axis=-1)

    first = edges(group.position[:, :1, : group.n_rigid])
    rows = []
    for correct in (True, False):
        position, _, _ = lib.roll(model, model.function(correct), group)
        stretch = 1e3 * np.abs(edges(position[:, :, : group.n_rigid]) - first).max()
        way = 'with' if correct else 'without'
        mse = metrics.rigid_mse(position, group.position[:, H:], group.n_rigid).mean()
        soil = model.soil_rms((position - group.position[:, H:])[:, :, group.n_rigid :])
        note = f'rigid MSE {1e4 * mse:.3g}e-4 m2, soil RMS {1e3 * np.sqrt((soil**2).mean()):.3g} mm'
        name = f'{model.name}, {way} rigid correction: largest change of a distance in the body'
        # float32 positions of half a metre round at 3e-5 mm; measured 2e-4.
        rows.append(judged(PART, name, float(stretch), 'mm', 2e-3 if correct else None, note))
    return rows


def run_all(is_quick, progress):
    """All rows and the curves by name."""
    rows: list[Case] = []
    curves: dict = {'horizon': [], 'growth': []}
    presets = ('pcg',) if is_quick else lib.PRESETS
    factor = 3 if is_quick else HORIZON
    jobs = [(scene, preset) for scene in lib.SCENES for preset in presets]
    for scene, preset in progress(jobs):
        model = lib.load(scene, preset, 1 if is_quick else None)
        function, long = model.function(), model.function()
        rolled, _, _ = lib.roll(model, function, model.group)
        row, curve = error_growth(model, rolled)
        rows.append(row)
        curves['growth'].append(curve)
        for continuation in CONTINUATIONS:
            if continuation == 'held at its end' and not given_body(model):
                continue  # nothing is given that could be continued in two ways
            row, curve = long_rollout(model, long, factor, continuation)
            rows.append(row)
            curves['horizon'].append(curve)
        rows.append(rest(model, function))
        if model.model.simulator.scene.rigid_motion == 'predicted':
            rows += rigid_shape(model)
    return rows, curves
