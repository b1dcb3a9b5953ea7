"""What a free tool shows: force in the air, starts in contact, sudden stops, soil inside the tool.

Per model, on a split of its dataset:

  air: the tool rides level, its lowest point 5 cm above the bed, at the mean speed of each run:
      the largest force after the first ten frames and in all
  start: begun in the middle of recorded runs, from the recorded soil: error of the force in the
      first frame, beside the root mean square error of the 2nd to 60th
  halts: in recorded runs, where the tool halts within a frame: the error of the force from that
      frame to 0.1 s later, beside that of all other frames in contact (root mean squares), and the
      true force before and after
  free: in the frames of rollouts of recorded runs in which the solver has no force: the mean of
      the predicted one, and in how many of them it is below 2 N
  inside: soil in the tool, in every 8th frame of rollouts, and in the truth as the dataset's modes
      hold it; the error in full space with such soil pushed out to the nearest face, over that
      without

Examples:
    python -m reports free_tool --models=models/excavation/pcg,models/excavation_v2/swept_field \\
        --output_path=docs/free_tool.json
    python -m reports documents docs/limits.md     # its table
"""

import os

import numpy as np
import tqdm
from absl import flags

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from mpm import bodies
from pca_tools import dataset, files, rigid_fit
from reports import command, markdown, record

SCHEMA_VERSION = 2
CLEAR = 0.05  # m, of the lowest point above the bed
RIDE, AFTER, AFTER_HALT = 60, 60, 6  # frames
EVERY = 8
DEEP = 1e-3  # m; less counts as touching
NO_FORCE, SMALL = 0.1, 2.0  # N, of the solver and of a prediction
FAST, STILL = 0.03, 1e-6  # m/s, m a frame
# Where the records come from another tool than the solver's, m.
SAME_TOOL = 1e-3


class Tool:
    """The solver's tool of a scene, in the axes and poses of `soil_physics`.

    Args:
      scene: its name, excavation or wheel.
      case: of the dataset's metadata; says how large a wheel is.
      points: [R, 3], m, all particles of the body in one frame.

    Raises:
      ValueError: a scene without a known tool, or particles that are not of it.
    """

    def __init__(self, scene: str, case: dict, points):
        from learning_to_simulate.methods.swept_field.axes import Axes
        from learning_to_simulate.methods.swept_field.tools import Blade

        middle = float(points[:, 2].mean())
        if scene == 'excavation':
            body = bodies.make_blade(0.0, case.get('blade_width_m', bodies.BLADE_WIDTH))
        elif scene == 'wheel':
            body = bodies.make_wheel(case['diameter_m'], 0.0)
        else:
            raise ValueError(f'the tool of the scene {scene} is not known: excavation or wheel')
        self._points = body.points
        if len(points) != len(body.points):
            raise ValueError(f'the body has {len(points)} particles, not {len(body.points)}')
        off = rigid_fit.fit_rigid_motion(body.points, points).residual
        if not off <= SAME_TOOL:
            raise ValueError(f'the particles of the body lie {off:.3g} m from those of the tool')
        self.radius = body.radius
        self._axes = Axes(0, -1, 1, middle)
        # A wheel is a blade without length, drawn out across.
        self._blade = Blade(2 * body.half_width, body.radius, body.length or 1e-9)

    def pose(self, points) -> np.ndarray:
        """float64 [7] of the reference point, of particles [R, 3]."""
        from learning_to_simulate.live import poses

        motion = rigid_fit.fit_rigid_motion(self._points, points)
        return np.concatenate([motion.translation, poses.quaternion_of(motion.rotation)])

    def inside(self, particles, points):
        """Depths [N], m, of soil [N, 3] in the tool whose particles are at [R, 3], and the soil
        with what is inside pushed out to the nearest face."""
        from learning_to_simulate.methods.swept_field import soil_physics

        plane = self._axes.poses(self.pose(points))
        soil = self._axes.points(particles)
        depth, way = soil_physics.inside(soil, plane, self._blade, self._blade.width)
        return depth, particles + self._axes.world(way)


def free(rollout) -> dict:
    """Of the frames of a rollout of a recorded run in which the truth has no force: how many they
    are, sum of the predicted sizes in N, and how many of these are below 2 N."""
    true = np.linalg.norm(rollout.truth[2][H:], axis=1)
    size = np.linalg.norm(rollout.force, axis=1)[true < NO_FORCE]
    small = int((size < SMALL).sum())
    return {'free_frames': len(size), 'free_N': float(size.sum()), 'free_small': small}


def penetration(tool: Tool, rollout, soil, recorded) -> dict:
    """Soil in the tool over a rollout of a recorded run.

    Args:
      tool: of the run.
      rollout: `SoilRollout` with its truth.
      soil: `Soil` of the dataset, which decodes the truth.
      recorded: `Trajectory` of the run, with all modes of the dataset.

    Returns:
      `deepest_mm` and `particles` (deeper than 1 mm, mean over frames) of the prediction, both with
      `true_` before them of the truth in the modes; `error_mm` and `pushed_error_mm`, root mean
      square distances of prediction and truth in the modes per component.
    """
    body, modes = rollout.truth[1], recorded.position[:, recorded.n_rigid :]
    found: dict[str, list] = {'': [], 'true_': []}
    square, pushed_square = [], []
    for frame in range(0, len(rollout.modes), EVERY):
        truth = soil.particles(modes[H + frame]).astype(np.float64)
        predicted = np.asarray(rollout.particles(frame), np.float64)
        depth, pushed = tool.inside(predicted, rollout.body[H + frame])
        found[''].append(depth)
        found['true_'].append(tool.inside(truth, body[H + frame])[0])
        square.append(((predicted - truth) ** 2).mean())
        pushed_square.append(((pushed - truth) ** 2).mean())
    rows = {}
    for name, depths in found.items():
        rows[f'{name}deepest_mm'] = 1e3 * float(np.max(depths))
        rows[f'{name}particles'] = float(np.mean([(d > DEEP).sum() for d in depths]))
    for name, values in (('error_mm', square), ('pushed_error_mm', pushed_square)):
        rows[name] = 1e3 * float(np.sqrt(np.mean(values)))
    return rows


def path_of(model, points) -> np.ndarray:
    """Poses [T, 7], as `stepper().start` takes them, of a recorded body [T, R, 3]."""
    from learning_to_simulate.live import poses

    starts = model.starts
    for body in starts.body:
        if len(body) == len(points[0]):
            motions = [rigid_fit.fit_rigid_motion(body, p) for p in points]
            if motions[0].residual <= SAME_TOOL:
                return np.array(
                    [np.concatenate([m.translation, poses.quaternion_of(m.rotation)])
                     for m in motions]
                )  # fmt: skip
    raise ValueError('no start of the model has the body of the run')


def air(model, path, lowest: float, bed: float) -> dict | None:
    """Largest forces of a level ride in the air, N; None of a body whose height is predicted.

    Args:
      model: `api.TrainedModel`.
      path: [T, 7] of a recorded run.
      lowest: m, height of the tool's lowest point in its first frame.
      bed: m, of the highest particle of the bed.
    """
    if model.scene.rigid_motion != 'prescribed':
        return None
    up = model.scene.up_axis
    velocity = (path[-1, :3] - path[0, :3]) / ((len(path) - 1) * model.scene.dt)
    velocity[up] = 0.0
    ride = np.repeat(path[:1], RIDE + 1, axis=0)
    ride[:, :3] += np.arange(RIDE + 1)[:, None] * velocity * model.scene.dt
    ride[:, up] += bed + CLEAR - lowest
    size = np.linalg.norm(model.rollout(ride).force, axis=1)
    return {'air_N': float(size.max()), 'air_settled_N': float(size[10:].max())}


def halts(rollout, dt: float) -> dict:
    """Of a rollout of a recorded run: how well it follows the force where the tool halts within a
    frame. The solver's force falls there, by more than half in two frames.

    Args:
      rollout: `SoilRollout` with its truth.
      dt: s, a frame.

    Returns:
      `halts`: number of them; `halt_before_N`, `halt_after_N`: sums of the true forces in the last
      frame of full speed and 0.1 s after the halt; `halt_square`, `halt_frames`: sum of the squared
      errors between, and how many; `other_square`, `other_frames`: of all others in contact.
    """
    body, force = rollout.truth[1], np.linalg.norm(rollout.truth[2], axis=1)
    square = ((np.asarray(rollout.force) - rollout.truth[2][H:]) ** 2).sum(axis=1)
    way = np.abs(np.diff(body, axis=0)).max(axis=(1, 2))  # [T - 1], from frame k to k + 1
    fast, still = way > FAST * dt, way < STILL
    # The velocity falls within a frame, of which two of the recorded ones may see a part.
    sudden = np.zeros_like(fast)
    sudden[4:] = fast[2:-2] & (way[2:-2] > 0.8 * way[:-4])  # not slowing down before
    halted = [k for k in range(H + 1, len(way) - AFTER_HALT)
              if sudden[k] and not still[k] and still[k + 1 : k + AFTER_HALT].all()]  # fmt: skip
    within = np.zeros(len(force), bool)
    for k in halted:
        within[k : k + AFTER_HALT + 1] = True
    within = within[H:]
    others = ~within & (force[H:] > NO_FORCE)
    return {
        'halts': len(halted),
        'halt_before_N': float(sum(force[k - 1] for k in halted)),
        'halt_after_N': float(sum(force[k + AFTER_HALT] for k in halted)),
        'halt_square': float(square[within].sum()),
        'halt_frames': int(within.sum()),
        'other_square': float(square[others].sum()),
        'other_frames': int(others.sum()),
    }


def start_in_contact(model, opened, group, path, soil) -> dict:
    """Errors of the force from the middle of a recorded run on.

    Returns:
      `first_N`: of the first frame; `later_N`: root mean square of the 2nd to 60th, both the size
      of a vector; `true_N`: the true force in the first frame.
    """
    half = len(path) // 2
    n, end = group.n_rigid, min(half + AFTER, len(path))
    true = group.force[0, half:end]
    if model.config.model == 'swept_field':
        live = model.stepper()
        velocity = (path[half - 1, :3] - path[half - 2, :3]) / model.scene.dt
        bed = soil.particles(group.position[0, half - 1, n:])
        live.start(path[half - 1], velocity, bed=bed)
        forces = [live.step(pose).force for pose in path[half:end]]
    else:
        from learning_to_simulate.live import stepping

        stepper = stepping.Stepper(model.model, n)
        stepper.reset(group.position[0, half - H : half], group.context_at(half, 0))
        known = model.scene.rigid_motion.is_known
        forces = [
            stepper.step(
                group.position[0, k, :n] if known else None,
                group.context_at(k, 0) if group.context_changes else None,
            ).force
            for k in range(half, end)
        ]
    error = np.linalg.norm(np.array(forces) - true, axis=1)
    return {
        'first_N': float(error[0]),
        'later_N': float(np.sqrt((error[1:] ** 2).mean())),
        'true_N': float(np.linalg.norm(true[0])),
    }


def measure(model, data, split: str, n_run: int = 0, kinds=()) -> list[dict]:
    """Rows of all runs of a split; see the module.

    Args:
      model: `api.TrainedModel` in a subspace, or of a swept field.
      data: `api.Dataset`.
      split: of it.
      n_run: so many runs, spread over the split; 0: all.
      kinds: of runs; none: all.

    Raises:
      ValueError: a scene whose tool is not known, or another tool than the solver's.
    """
    from learning_to_simulate.live.soil import Soil
    from learning_to_simulate.methods import registry

    opened = registry.open_model(model.path, data.path, split)
    soil = Soil(data.subspace, model.scene.up_axis)
    up, rows = model.scene.up_axis, []
    groups = sorted(
        (g.select(i) for g in opened.groups for i in range(len(g.record))),
        key=lambda g: int(g.record[0]),
    )
    if kinds:
        cases = data.metadata['cases'][split]
        groups = [g for g in groups if cases[int(g.record[0])].get('kind') in kinds]
    if 0 < n_run < len(groups):
        groups = [groups[i] for i in np.linspace(0, len(groups) - 1, n_run).astype(int)]
    for group in tqdm.tqdm(groups, desc='runs'):
        number = int(group.record[0])
        case = data.metadata['cases'][split][number]
        recorded = getattr(data, split).records[number]
        points = recorded.position[:, : recorded.n_rigid].astype(np.float64)
        tool = Tool(model.scene.name, case, points[0])
        path = path_of(model, points)
        bed = float(soil.particles(recorded.position[0, recorded.n_rigid :])[:, up].max())
        lowest = float(tool.pose(points[0])[up]) - tool.radius
        row = {'case': case.get('case', number), 'kind': case.get('kind') or 'grid'}
        row |= air(model, path[H:], lowest, bed) or {}
        row |= {f'start_{k}': v
                for k, v in start_in_contact(model, opened, group, path, soil).items()}  # fmt: skip
        run = getattr(data, split)[number]
        rollout = model.rollout(run)
        row |= free(rollout) | halts(rollout, model.scene.dt)
        rows.append(row | penetration(tool, rollout, soil, recorded))
    return rows


def _free(rows):
    frames, force, small = (
        sum(row.get(f'free_{name}', 0) for row in rows) for name in ('frames', 'N', 'small')
    )
    return f'{force / frames:.3g} ({100 * small / frames:.0f} %)' if frames else ''


def _halt(rows):
    def total(key):
        return sum(row.get(key, 0) for row in rows)

    if not total('halts'):
        return ('',) * 3
    forces = (total(f'halt_{when}_N') / total('halts') for when in ('before', 'after'))
    at, other = (
        float(np.sqrt(total(f'{where}_square') / total(f'{where}_frames')))
        for where in ('halt', 'other')
    )
    return at, other, '{:.0f} to {:.0f}'.format(*forces)


def table(path: str) -> str:
    """The means and extremes of every model, from the JSON of this report."""
    lines = []
    for found in files.read_json(path)['models']:
        rows = found['runs']

        def of(name, how, rows=rows):
            values = [row[name] for row in rows if name in row]
            return float(how(values)) if values else None

        lines.append(
            (
                found['model'],
                of('air_N', np.max),
                _free(rows),
                of('start_first_N', np.mean),
                of('start_later_N', np.mean),
                *_halt(rows),
                f'{of("deepest_mm", np.max):.1f} / {of("true_deepest_mm", np.max):.1f}',
                f'{of("particles", np.mean):.1f} / {of("true_particles", np.mean):.1f}',
                of('pushed_error_mm', np.mean) / of('error_mm', np.mean),
            )
        )
    header = (
        'model', 'in the air, N', 'without a true force, N (below 2 N)',
        'first frame of a start, N', 'later frames, N',
        'at a sudden halt, N', 'elsewhere, N', 'true force falls, N', 'deepest, mm (/ truth)',
        'particles inside (/ truth)', 'error pushed out / as it is',
    )  # fmt: skip
    return markdown.table(header, lines)


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_list('models', None, 'Model folders.', required=True)
    flags.DEFINE_list('data', None, 'Their datasets; default: datasets/<scene of the path>.')
    flags.DEFINE_enum('split', 'test', dataset.SPLITS, 'Runs that are looked at.')
    flags.DEFINE_list('kinds', [], 'Kinds of runs; default: all.')
    flags.DEFINE_integer('runs', 0, 'So many runs, spread over the split; 0: all.', 0)
    flags.DEFINE_string(
        'output_path', None, 'JSON file to write; other models in it stay.', required=True
    )
    flags.DEFINE_integer('num_threads', 2, 'CPU threads of TensorFlow.', lower_bound=1)


def main(values, _) -> None:
    """Runs the command."""
    from learning_to_simulate import api

    names = [os.path.basename(os.path.dirname(os.path.normpath(path))) for path in values.models]
    data = values.data or [os.path.join('datasets', name) for name in names]
    if len(data) != len(values.models):
        raise ValueError(f'{len(values.models)} models but {len(data)} datasets')
    kept: list[dict] = []
    if os.path.exists(values.output_path):
        kept = files.read_json(values.output_path)['models']
    for path, folder in zip(values.models, data):
        print(f'measuring {path} ...', flush=True)
        opened = api.TrainedModel(path), api.Dataset(folder)
        rows = measure(*opened, values.split, values.runs, values.kinds)
        head = {'schema_version': SCHEMA_VERSION, **record.provenance(values.num_threads)}
        name = os.path.normpath(path)
        kept = [found for found in kept if found['model'] != name]
        kept.append({'model': name, 'split': values.split, **head, 'runs': rows})
        files.write_json(values.output_path, {'models': kept})
    print(table(values.output_path))


if __name__ == '__main__':
    command.start(define_flags, main)
