"""Closed-loop rollouts of a soil field over recorded runs, and how far they are from the truth.

Each run begins on its bed as it was before the tool stood on it; from then on the terrain is what
the model makes of it. Errors are those of frames H on, as of all methods; docs/soil_field.md says
what each is, and what stands beside the model. Bounds are calibrated on runs of valid (`bounds_of`)
and judged on frames inside of training of all: `bound_kept` and `near_95_mm`.
"""

import functools
from collections import Counter

import numpy as np

from learning_to_simulate import error_bound, metrics
from learning_to_simulate.baselines import earthmoving
from learning_to_simulate.baselines import wheel_terramechanics as terramechanics
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.evaluation import without_nan
from learning_to_simulate.rollout_status import Judgement, RolloutStatus
from learning_to_simulate.soil_field import samples, sweep
from learning_to_simulate.soil_field.loaded import COORDINATES, LoadedTool
from learning_to_simulate.soil_field.place import place_of
from learning_to_simulate.soil_field.rollout import TerrainRollout, roll_out
from learning_to_simulate.soil_field.runs import Machine, Run
from learning_to_simulate.soil_field.stepper import SoilStepper
from learning_to_simulate.soil_field.tools import Blade
from learning_to_simulate.soil_truth import PARTICLES

NEAR, RISEN = 0.1, 0.003  # m of the field
# m of the field: of a map that has moved by so much, twice the error of one at rest is as good.
MOTION = 0.001
# Name of the formula of a tool.
FORMULAS = {'blade': 'earthmoving', 'wheel': 'bekker_wong_janosi'}
# What the model is compared in, run by run.
JUDGED = (
    'soil_mm', 'surface_mm', 'near_mm', 'front_mm', 'heap_error_litre', 'force_relative_l2',
    'drawbar_relative_l2', 'vertical_relative_l2', 'pitch_relative_l2',
)  # fmt: skip


class SoilEvaluator:
    """Rolls out a field along runs and judges it, as `evaluation.Evaluator`; `members` of its
    networks (None: all). `under_load`: runs are also predicted from what moved their tool; it takes
    ten times as long."""

    def __init__(self, field, members: int | None = None, under_load: bool = True):
        self._field, self._members, self._under_load = field, members, under_load

    def roll_out(self, run: Run, under_load: bool = False) -> TerrainRollout:
        """The rollout of a run along its path, or under what moved its tool (ValueError where it
        does not record that). One that the model refuses is not a number from the start, and its
        judgement says why."""
        if under_load and run.machine is None:
            raise ValueError(f'run {run.case} does not record what moved its tool')
        terrain, name = run.before(), f'rollout_{run.case}'
        stepper = SoilStepper(self._field, terrain, run.tool, self._members)
        given = None if run.particles is None else run.particles[0]
        step = _loaded(stepper, run, run.machine) if under_load and run.machine else None
        try:
            return roll_out(stepper, run.pose, run.dt, run.stride, step, given, run=run, name=name)
        except ValueError as error:
            return _refused(run, name, str(error))

    def run(self, groups: list[Run], split: str, progress=iter):
        """Rolls out runs and judges them.

        Returns:
          list of (number, None, `TerrainRollout`), and a summary: `mean` and `median` of errors by
          column, `wins` (column -> error -> on how many of how many runs the model is the better),
          `kinds` of runs likewise, `status` counts, and every run.
        """
        known = FORMULAS[self._field.networks.tool.name]
        results, rows = [], {'model': [], 'under_load': [], 'stay_still': [], known: []}
        for number, run in enumerate(progress(groups)):
            rollout = self.roll_out(run)
            results.append((number, None, rollout))
            who = {'record': number, 'case': run.case, 'kind': run.kind}
            rows['model'].append(who | of_rollout(rollout, run))
            rows['stay_still'].append(who | still(run))
            if self._under_load and run.machine is not None:
                free = self.roll_out(run, under_load=True)
                moved = motion_errors(free.pose, run)
                rows['under_load'].append(who | of_rollout(free, run) | moved)
            if (found := formula(run)) is not None:
                rows[known].append(who | found)
        return results, summarise({name: of for name, of in rows.items() if of})


def _loaded(stepper, run: Run, machine: Machine):
    free = tuple(name for name, is_free in zip(COORDINATES, machine.free, strict=True) if is_free)
    tool = LoadedTool(
        stepper, machine.mass, machine.inertia or None, free, machine.stiffness, machine.damping
    )
    # What a `LoadedTool` weighs is in the external load already.
    weight = np.array([0.0, machine.mass * run.soil.gravity, 0.0])
    place = place_of(run.pose[0])
    places = place.local(machine.target[:, :3])
    places[:, 2] = np.unwrap(place.turns(machine.target)[:, 0])
    rates = np.diff(places, axis=0, prepend=places[:1]) / run.dt  # along, up, lean

    def step(t):
        # Dampers of the machine act on the motion against that of the target; those of a
        # `LoadedTool` on the motion alone, so that of the target is a force.
        along, up, turn = machine.damping * rates[t]
        force = machine.external[t, :3] + weight + place.vectors([along, up, 0.0])
        torque = float(machine.external[t, 3:] @ place.across) + turn
        return tool.step(machine.target[t], force, torque, run.dt)

    return step


def _refused(run, name, reason):
    def none(values):
        return np.full(np.shape(values), np.nan, np.float32)

    judgement = Judgement(RolloutStatus.NON_FINITE, 0, -1, f'refused: {reason}')
    return TerrainRollout(
        run.tool, run.before(), none(run.pose), none(run.force), none(run.torque),
        np.arange(0, len(run.pose), run.stride), none(run.heights),
        (judgement.status,) * len(run.pose), none(run.force), none(run.dt + run.force[:, 0]),
        judgement, run.dt,
        particles=None if run.particles is None else none(run.particles), run=run, name=name,
    )  # fmt: skip


def of_rollout(rollout: TerrainRollout, run: Run) -> dict:
    found = load_errors(run, rollout.force[H:], rollout.torque[H:])
    found |= terrain_errors(run, rollout.heights) | soil_errors(run, rollout.particles)
    found |= _bound_figures(rollout, run) | payload_errors(rollout, run)
    flagged = np.mean([status != RolloutStatus.OK for status in rollout.frame_status])
    return (
        found
        | rollout.judgement.fields()
        | {
            'flagged_share': float(flagged),
            'milliseconds_per_step': 1e3 * rollout.seconds / len(rollout),
            'seconds_per_simulated_second': rollout.seconds / (len(rollout) * rollout.dt),
        }
    )


def _bound_figures(rollout, run):
    off = np.linalg.norm((rollout.force - run.force)[H:], axis=1)
    inside, found = _inside(rollout), {}
    known = slice(-(-H // run.stride), None)
    maps = rollout.heights.astype(np.float64)[known][:, near(run)]
    parts = run.heights[known][:, near(run)], run.before().heights[near(run)]
    error, moved = (np.sqrt(((maps - other) ** 2).mean(axis=1)) for other in parts)
    rows = 1e3 * error / run.tool.scale / (1.0 + moved / (run.tool.scale * MOTION))
    at = inside[rollout.frames[known] - H]
    if not np.isfinite(rows).all():  # a run that is refused keeps no bound
        found['near_95_mm'] = float('nan')
    elif at.any():
        found['near_95_mm'] = float(np.quantile(rows[at], error_bound.FRAMES_WITHIN))
    if np.isfinite(rollout.bound).any() and inside.any():
        limit = rollout.bound[H:][inside]
        # What is not a number compares as false: it keeps no bound.
        found['bound_kept'] = float((off[inside] <= limit).mean())
        found['bound_newton'] = float(limit.mean())
    return found


def payload_errors(rollout: TerrainRollout, run: Run) -> dict[str, float]:
    """What a bucket holds in the air, by its weight, litres; {} of a run that lifts none."""
    high = run.before().heights.max() + run.tool.scale * run.tool.lifted
    over = run.pose[:, 1] - run.tool.radius > high
    over[: int(np.argmax(~over))] = False  # before it has dug
    if not getattr(run.tool, 'bucket', 0.0) or not over.any():
        return {}
    held, true = (
        -1e3 * float(force[over, 1].mean()) / (run.soil.density * run.soil.gravity)
        for force in (rollout.force, run.force)
    )
    return {'payload_litre': held, 'true_payload_litre': true, 'payload_error_litre': held - true}


def _inside(rollout) -> np.ndarray:
    return np.array([status == RolloutStatus.OK for status in rollout.frame_status[H:]], bool)


def bounds_of(results, rows: list[dict]) -> dict:
    """`SoilField.bounds` of results and rows of errors of valid runs: no training has seen them,
    and none has chosen when a training ends, which is after the steps of its preset. {} where the
    field answers none of the runs. Runs that it refuses do not count, nor do frames that it
    flags."""
    runs, near, kinds = [], [], []
    for (_, _, rollout), row in zip(results, rows, strict=True):
        inside = _inside(rollout)
        if not inside.any():
            continue
        unit = rollout.tool.units(rollout.run.soil)[0]
        columns = rollout.force - rollout.run.force, rollout.spread, rollout.force
        runs.append(tuple(np.linalg.norm(x[H:][inside], axis=1) / unit for x in columns))
        near.append(row.get('near_95_mm', 0.0))
        kinds.append(rollout.run.kind)
    if not runs:
        return {}
    return {
        'force': error_bound.calibrate(runs, kinds),
        'near_mm': error_bound.of_runs(near, kinds),
    }


def motion_errors(pose, run: Run) -> dict[str, float]:
    """Errors of a motion [T, 7] along the way and in height, mm."""
    along = place_of(run.pose[0]).along
    off = (pose - run.pose)[H:, :3]
    return {'travel_mm': _rms_mm(off @ along), 'height_mm': _rms_mm(off[:, 1])}


def still(run: Run) -> dict:
    """Errors of persistence: soil and load of frame H - 1 for ever."""
    count, given = len(run.pose) - H, (H - 1) // run.stride
    force, torque = (np.repeat(x[H - 1 : H], count, axis=0) for x in (run.force, run.torque))
    heights, points = (
        None if x is None else np.broadcast_to(x[given], x.shape)
        for x in (run.heights, run.particles)
    )
    found = load_errors(run, force, torque) | terrain_errors(run, heights)
    return found | soil_errors(run, points)


def load_errors(run: Run, force, torque=None) -> dict[str, float]:
    """`metrics.load_errors` of a force [T - H, 3] (N) and torque (N m), and those of the force
    across the way as `side`. A whole force below `LEAST_FORCE` of the field counts as that."""
    place = place_of(run.pose[0])
    force, truth, *torques = (
        None if x is None else (np.asarray(x, np.float64) @ place.axes.T)[None]
        for x in (force, run.force[H:], torque, None if torque is None else run.torque[H:])
    )
    found = metrics.load_errors(force, truth, (0, 1, 2), *torques)
    least = samples.LEAST_FORCE * run.tool.units(run.soil)[0]
    found |= metrics.force_errors(force, truth, least=least)
    found |= metrics.force_errors(force[..., 2:], truth[..., 2:], 'side')  # type: ignore[index]
    return {name: float(value[0]) for name, value in found.items()}


def terrain_errors(run: Run, heights) -> dict[str, float]:
    """Errors of maps [F, nx, nz] (m) of the frames of a run that have one."""
    late = slice(-(-H // run.stride), None)
    heights, true = np.asarray(heights, np.float64), run.heights
    before, area = run.before().heights, float(np.prod(run.cell))
    off = (heights - true)[late]
    found = {'surface_mm': _rms_mm(off), 'near_mm': _rms_mm(off[:, near(run)])}
    fronts = [front(run, before, maps)[late] for maps in (heights, true)]
    found['front_mm'] = _rms_mm(fronts[0] - fronts[1])
    litres = []
    for last in (heights[-1], true[-1]):
        change = 1e3 * area * (last - before)
        cut, heap = -change[change < 0].sum(), change[change > 0].sum()
        volumes = np.array([cut, heap, heap - cut])
        litres.append(volumes if np.isfinite(last).all() else np.full(3, np.nan))
    for i, name in enumerate(('cut', 'heap', 'net')):
        found |= {
            f'{name}_litre': float(litres[0][i]),
            f'true_{name}_litre': float(litres[1][i]),
            f'{name}_error_litre': float(abs(litres[0][i] - litres[1][i])),
        }
    return found


def soil_errors(run: Run, points) -> dict[str, float]:
    """The error of particles [F, P, 3] (m) of the frames of a run that have them; {} without."""
    if points is None or run.particles is None:
        return {}
    return {'soil_mm': metrics.soil_mm(points, run.particles, run.stride)}


def _rms_mm(values) -> float:
    return float(1e3 * np.sqrt(np.mean(np.square(values))))


def _places(run):
    """Of the cells of a run's map: u and distance across [nx, nz], m, seen from its first pose."""
    place, terrain = place_of(run.pose[0]), run.terrain()
    x, z = np.meshgrid(*terrain.middles, indexing='ij')
    local = place.local(np.stack([x, np.zeros_like(x), z], axis=-1))
    return local[..., 0], local[..., 2]


def near(run: Run) -> np.ndarray:
    """bool [nx, nz]: cells within `NEAR` of what the tool passed while it was in the soil; all
    where it never was."""
    place, scale = place_of(run.pose[0]), run.tool.scale
    u, across = _places(run)
    path = place.local(run.pose[:, :3])
    low = run.pose[:, 1] - run.tool.radius < run.before().heights.max()
    if not low.any():
        return np.ones(u.shape, bool)
    reach = scale * NEAR
    at = path[low]
    along = np.abs(u.ravel()[:, None] - at[:, 0]) <= reach + run.tool.radius
    beside = np.abs(across.ravel()[:, None] - at[:, 2]) <= reach + run.tool.width / 2
    return (along & beside).any(axis=1).reshape(u.shape)


def front(run: Run, before, heights) -> np.ndarray:
    """[F] m: how far ahead of the tool soil stands `RISEN` higher in maps [F, nx, nz] than before
    [nx, nz], in the mean over the tool's width; 0 where it does not."""
    place, scale = place_of(run.pose[0]), run.tool.scale
    u, across = _places(run)
    path = place.local(run.pose[:: run.stride, :3])
    spacing, found = float(run.cell.max()), []
    row = np.rint((u - u.min()) / spacing).astype(int)
    for (tip, _, aside), now in zip(path, heights, strict=True):
        under = np.abs(across - aside) <= run.tool.width / 2
        count = np.bincount(row[under], minlength=row.max() + 1)
        rise = np.bincount(row[under], (now - before)[under], minlength=row.max() + 1)
        rise = rise / np.maximum(count, 1)
        places = u.min() + spacing * np.arange(len(rise))
        high = np.flatnonzero((rise >= scale * RISEN) & (places > tip))
        if not np.isfinite(rise).all():
            found.append(np.nan)
        elif not len(high):
            found.append(0.0)
        else:
            k = high[-1]
            beyond = rise[k + 1] if k + 1 < len(rise) else 0.0
            # On the straight line between the two rows.
            share = (rise[k] - scale * RISEN) / max(rise[k] - beyond, 1e-12)
            found.append(places[k] + spacing * min(share, 1.0) - tip)
    return np.array(found)


def formula(run: Run) -> dict | None:
    """Errors of the loads that the literature's formula gives, with the soil's own parameters, on
    the recorded terrain; None where it says nothing of the run."""
    place = place_of(run.pose[0])
    if isinstance(run.tool, Blade):
        if run.tool.bucket:  # the equation is of a face
            return None
        try:
            force, torque = _earthmoving(run), None
        except ValueError:  # a path that nobody can follow
            return None
    elif run.machine is not None:
        force, torque = _terramechanics(run, place)
    else:
        return None
    return load_errors(run, place.vectors(force)[H:], None if torque is None else torque[H:])


def edge_depth(run: Run, frames: sweep.Frame) -> np.ndarray:
    """[T] m: how deep the lowest point of a tool lies under the terrain right ahead of it; frames
    of `samples.episode_of`."""
    tip, height = (frames.scalars[:, 0, sweep.SCALARS.index(n)] for n in ('tip', 'height'))
    scale = run.tool.scale
    ahead = tip.astype(np.float64) + run.tool.radius / scale + sweep.SPACING
    profile = (frames.bins[..., sweep.SURFACE] - frames.bins[..., sweep.CUT]).mean(axis=1)
    found = [np.interp(x, sweep.OFFSETS, p) for x, p in zip(ahead, profile, strict=True)]
    return scale * (np.array(found) - height.astype(np.float64)) + run.tool.radius


def _earthmoving(run):
    """[T, 3] N along, up, across, of `earthmoving.cutting_force`: the depth is `edge_depth`, the
    heap all that was cut."""
    whole = samples.episode_of(run)
    frames, passage = whole.frames, whole.passage
    scalars = {n: frames.scalars[:, 0, i].astype(np.float64) for i, n in enumerate(sweep.SCALARS)}
    soil, area = earthmoving.BladeSoil.of(run.soil, run.tool), run.tool.scale**2 * scalars['area']
    depth, rake = edge_depth(run, frames), np.pi / 2 - scalars['lean']
    parts = earthmoving.cutting_force(depth, rake, area, soil)
    u = passage.place.local(run.pose[:, :3])[:, 0]
    step, forward = np.diff(u, prepend=u[0]), np.zeros(len(u), bool)
    for t in range(1, len(u)):
        forward[t] = forward[t - 1] if step[t] == 0 else step[t] > 0
    backward, up = (parts.sum(axis=-2) * forward[:, None]).T
    return np.stack([-backward, up, 0 * up], axis=1)


def _terramechanics(run, place):
    """Force [T, 3] along, up, across (N) and torque [T, 3] in the world (N m) of a wheel by Bekker,
    Wong and Janosi, under its load."""
    tool = run.tool
    lean = np.unwrap(place.turns(run.pose)[:, 0])
    u = place.local(run.pose[:, :3])[:, 0]
    wheel = terramechanics.Wheel(
        tool.radius, tool.width, -run.machine.external[:, 1], run.soil.gravity, run.soil.friction,
        terramechanics.RIM_FRICTION,
    )  # fmt: skip
    motion = terramechanics.drive(
        wheel, u - u[0], -tool.radius * (lean - lean[0]), terramechanics.TerrainParameters()
    )
    force = np.stack([motion.drawbar, motion.vertical, 0 * motion.drawbar], axis=1)
    # A wheel that rolls on leans forward (-); the soil turns it back.
    return force, motion.torque[:, None] * place.across


def summarise(rows: dict[str, list[dict]]) -> dict:
    """See `SoilEvaluator.run`; `rows` are columns -> errors of their runs."""
    by_run = {name: {row['record']: row for row in of} for name, of in rows.items()}
    model = by_run['model']
    kinds = sorted({row['kind'] for row in model.values()})
    wins = {
        other: {
            key: [sum(model[i][key] < row[key] for i, row in there.items()), len(there)]
            for key in JUDGED
            if all(key in row and key in model[i] for i, row in there.items())
        }
        for other, there in by_run.items()
        if other not in ('model', 'under_load')
    }
    summary = {
        'method': 'soil_field',
        'soil_error': PARTICLES,
        'mean': {name: _over(of, np.mean) for name, of in rows.items()},
        'median': {name: _over(of, np.median) for name, of in rows.items()},
        'wins': wins,
        'kinds': {
            kind: {name: _over([r for r in of if r['kind'] == kind], np.median)
                   for name, of in rows.items()}
            for kind in kinds
        },
        'status': dict(Counter(row['status'] for row in model.values())),
        'runs': rows,
    }  # fmt: skip
    return without_nan(summary)


def _over(rows, statistic) -> dict:
    """A statistic of every number of rows that all of them have, and their count; times: the
    median. A run without a number is infinitely wrong: medians hold, means do not."""
    if not rows:
        return {}
    numbers = functools.reduce(
        lambda kept, row: [k for k in kept if k in row],
        rows[1:], [k for k, v in rows[0].items() if isinstance(v, float)],
    )  # fmt: skip
    times = 'milliseconds_per_step', 'seconds_per_simulated_second'
    found = {'runs': len(rows)}
    for key in numbers:
        values = np.nan_to_num([row[key] for row in rows], nan=np.inf)
        found[key] = float((np.median if key in times else statistic)(values))
    return found
