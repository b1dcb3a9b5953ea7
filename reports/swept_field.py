"""Measures what a swept field promises: each run of a split, and what should change little.

Per run, on the particle sample in full space: errors, penetration, heap, force in the air, as
`metrics.json` has them, and

  resampled: the same path at half and at twice the rate; soil error over that at the given rate
  restart: the run begun anew half-way, on the bed that the model itself predicts there, and on
      the true one; soil error of the second half, beside that of the run in one piece

how many frames are `ok`, and how far the force is off in these and in the others; of a wheel also
errors of sinkage and torque, beside a height and a force that are held; of models `--beside` it
their soil, force and status on the same runs; and once, of a blade: ten lengths of a run, there and
back over the same bed, begun anew after each of them on the predicted bed: what becomes of the
bed's height and of particles near its floor.

Examples:
    python -m reports swept_field --model_path=MODEL --data_path=DATA --split=test \\
        --output_path=docs/swept_field.json
    python -m reports swept_field --model_path=MODEL --data_path=BEYOND --beside=pcg=OTHER \\
        --output_path=docs/swept_field_beyond.json
    python -m reports documents docs/swept_field.md     # its tables
"""

import os

import numpy as np
import tqdm
from absl import flags

from learning_to_simulate.command import named_paths
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.methods import registry
from pca_tools import files
from reports import command, markdown, record

SCHEMA_VERSION = 2
LENGTHS = 10
ROOM = 0.03  # m, of the bins behind a start, for the tool itself
_RATES = {'half_rate': 0.5, 'double_rate': 2.0}


def resampled(pose, rate: float) -> np.ndarray:
    """Poses [T', 3] of a path [T, 3] at half or twice its rate, straight between given ones."""
    at = np.arange(0, len(pose) - 1 + 1e-9, 1.0 / rate)
    return np.stack([np.interp(at, np.arange(len(pose)), x) for x in pose.T], axis=1)


def soil_error(field, bed, size, pose, dt: float, frames, rest, truth) -> np.ndarray:
    """Mean squared error [F] (m2) of particles over a path.

    Args:
      field: `SweptField`.
      bed: `tool_path.Bed` of one tool.
      size: [S] and pose: [T, K] of the tool.
      dt: between poses, s.
      frames: int [F] of them in which particles are known.
      rest: [P, 3] where these were at first, u, height, distance from the middle plane.
      truth: [F, P, 3] where they are.
    """
    from learning_to_simulate.methods.swept_field.tool_path import Frame

    _, found = field.frames(bed, size, pose, dt)
    chosen = Frame(found.bins[frames], found.scalars[frames])
    origin = np.array([pose[0, 0], bed.level[0], 0.0])
    moved = field.displacement(chosen, (rest - origin).astype(np.float32)).mean(axis=0)
    return ((rest + moved - truth) ** 2).mean(axis=(1, 2))


def steadiness(field, evaluator, split: str, group) -> dict:
    """`resampled` and `restart` of a run, see the module.

    Args:
      field: `SweptField`.
      evaluator: `FieldEvaluator` of the split.
      split: of the run.
      group: one-run `RunGroup` of it.
    """
    from learning_to_simulate.methods.swept_field import beds, quality
    from learning_to_simulate.methods.swept_field.field_soil import FieldSoil, Ground, Swept
    from learning_to_simulate.methods.swept_field.tool_path import Frame

    episode = evaluator.episode(int(group.record[0]))
    dt, late, axes = field.scene.dt, episode.frames >= H, field.axes
    truth = episode.rest + episode.moved

    def error(bed, first, rest, rate=1.0):
        frames = (rate * (episode.frames[first:] - episode.frames[first])).astype(int)
        pose = resampled(episode.pose[episode.frames[first] :], rate)
        return soil_error(field, bed, episode.size, pose, dt / rate, frames, rest, truth[first:])

    def rms(square):
        return 1e3 * float(np.sqrt(square.mean()))

    whole = error(episode.bed, 0, episode.rest)
    row = {
        name: rms(error(episode.bed, 0, episode.rest, rate)[late]) / rms(whole[late])
        for name, rate in _RATES.items()
    }
    _, known = field.frames(episode.bed, episode.size, episode.pose, dt)
    status = quality.statuses(known.scalars[1:], field.ranges, True, field.tool.scalars)
    ok = np.array([str(one) == 'ok' for one in status])
    off = field.loads(known).mean(axis=0)[1:, :2] - episode.load[1:, :2]
    row['ok_share'] = float(ok.mean())
    for name, frames in (('ok_force_N', ok), ('other_force_N', ~ok)):
        square = (off[frames] ** 2).sum(axis=1)
        row[name] = float(np.sqrt(square.mean())) if frames.any() else None
    half = len(episode.frames) // 2
    middle = int(episode.frames[half])
    pose, found = field.frames(episode.bed, episode.size, episode.pose[: middle + 1], dt)
    points = evaluator.bed(group)
    origin = np.array([episode.pose[0, 0], episode.level, 0.0])
    ground = Ground(points, axes.points(points), origin, episode.size)
    swept = Swept(Frame(found.bins[middle:], found.scalars[middle:]), pose[middle], ground)
    predicted = FieldSoil(field).particles(swept).astype(np.float64)
    own = axes.points(predicted[np.asarray(evaluator.reader.sample(split).indices)])
    row['second_half_mm'] = rms(whole[half + 1 :])
    for name, points, rest in (
        ('restart_predicted_mm', predicted, own),
        ('restart_true_mm', evaluator.bed(group, middle), truth[half]),
    ):
        _, bed = beds.ground(field, episode.pose[middle], episode.size, points)
        row[name] = rms(error(bed, half, rest)[1:])
    return row


def ten_lengths(model, poses) -> dict:
    """There and back over one bed, `LENGTHS` times; see the module.

    Args:
      model: `api.TrainedModel`.
      poses: [T, 7] of a run.
    """
    live = model.stepper()
    up = model.scene.up_axis
    live.start(poses[0])
    first = live.particles()
    floor, ok, largest = first[:, up].min(), [], 0.0
    way = poses
    for k in range(LENGTHS):
        for pose in way[1:]:
            frame = live.step(pose)
            ok.append(frame.now == 'ok')
            largest = max(largest, float(np.linalg.norm(frame.force)))
        bed, way = live.particles(), way[::-1]
        if k < LENGTHS - 1:
            live.start(way[0], bed=bed)
    return {
        'frames': len(ok),
        'ok_share': float(np.mean(ok)),
        'largest_force_N': largest,
        'mean_height_change_mm': 1e3 * float(bed[:, up].mean() - first[:, up].mean()),
        'lowest_below_floor_mm': 1e3 * float(max(floor - bed[:, up].min(), 0.0)),
        'highest_above_bed_mm': 1e3 * float(bed[:, up].max() - first[:, up].max()),
    }


def measure(model, data, split: str) -> dict:
    """All rows of a model on a split, see the module.

    Args:
      model: `api.TrainedModel` of the method swept_field.
      data: `api.Dataset`.
      split: of it.
    """
    opened = registry.open_model(model.path, data.path, split)
    evaluator, field = opened.evaluator, model.model.field
    _, summary = evaluator.run(opened.groups, split, lambda x: tqdm.tqdm(x, desc='runs'))
    cases = data.metadata.get('cases', {}).get(split, [])
    groups = {int(g.record[i]): g.select(i) for g in opened.groups for i in range(len(g.record))}
    rows, numbers = [], [fact.pop('record') for fact in summary['field']]
    steps = tqdm.tqdm(summary['field'], desc='steadiness', disable=None)
    for number, fact in zip(numbers, steps, strict=True):
        case = cases[number] if number < len(cases) else {}
        row = {'case': case.get('case', number), 'kind': case.get('kind', 'run')} | fact
        rows.append(row | steadiness(field, evaluator, split, groups[number]))
    found = {'runs': rows, 'reliability': summary['reliability']}
    if field.tool.predicts_height:  # begins anew only where it stands in its own print
        return found
    records = getattr(data, split).records
    paths = [records[number].rigid_pose.astype(float) for number in numbers]
    fitting = [k for k in range(len(rows)) if _way_back(paths[k]) < field.grid.behind - ROOM]
    if not fitting:
        return found
    # The run that cuts most leaves the most to a bed that is driven over again.
    most = max(fitting, key=lambda k: rows[k]['cut_litre'])
    return found | {'ten_lengths': {'case': rows[most]['case']} | ten_lengths(model, paths[most])}


def errors_of(model_path: str, data_path: str, split: str) -> list[dict]:
    """Soil in full space (mm), force (relative L2) and status of a model's rollouts, by record.

    Args:
      model_path: a folder of any method.
      data_path, split: runs that it rolls out.
    """
    opened = registry.open_model(model_path, data_path, split)
    _, summary = opened.evaluator.run(opened.groups, split, lambda x: tqdm.tqdm(x, desc='beside'))
    keys = {'soil_rms_mm_full': 'mm', 'force_relative_l2': 'force_l2', 'status': 'status'}
    rows = sorted(summary['runs']['model'], key=lambda row: row['record'])
    found = [{short: row[key] for key, short in keys.items()} for row in rows]
    # What a field moves is not of the modes: its error is that of the sampled particles.
    own = {fact['record']: {'mm': fact['soil_mm']} for fact in summary.get('field', ())}
    return [one | own.get(row['record'], {}) for one, row in zip(found, rows, strict=True)]


def _way_back(poses) -> float:
    """How far, m, the places of a path [T, 7] lie from its end, where the way back begins."""
    return float(np.linalg.norm(poses[:, :3] - poses[-1, :3], axis=1).max())


def by_kind(path: str) -> str:
    """A table of the errors by kind of path, from the JSON of this report."""
    rows = files.read_json(path)['runs']
    kinds = sorted({row['kind'] for row in rows})
    columns = {k: v for k, v in _COLUMNS.items() if k in rows[0]}
    lines = []
    for kind in [*kinds, None]:
        mine = [row for row in rows if kind in (None, row['kind'])]
        means = [float(np.mean([row[key] for row in mine])) for key in columns]
        won = sum(row['soil_mm'] < row['still_mm'] for row in mine)
        lines.append((kind or '**all**', len(mine), *means, f'{won} of {len(mine)}'))
    header = ('test', 'runs', *columns.values(), 'better than still')
    return markdown.table(header, lines)


def steady(path: str) -> str:
    """A table of what should change little, from the JSON of this report."""
    rows = files.read_json(path)['runs']
    lines = []
    for key, name in _STEADY.items():
        values = [row[key] for row in rows]
        lines.append((name, *(float(f(values)) for f in (np.mean, np.min, np.max))))
    return markdown.table(('', 'mean', 'least', 'most'), lines)


def trials(path: str) -> str:
    """A table of what was tried, judged on valid runs: means over runs, and on how many the soil
    was better than in the first row."""
    rows = files.read_json(path)['rows']
    first = rows[0]['soil_mm']
    lines = []
    for row in rows:
        won = sum(a < b for a, b in zip(row['soil_mm'], first, strict=True))
        wins = '' if row is rows[0] else f'{won} of {len(first)}'
        means = (float(np.mean(row[key])) for key in ('soil_mm', 'force_l2'))
        lines.append((row['what'], *means, wins))
    return markdown.table(('trial', 'soil, mm', 'force', 'better in soil'), lines)


def beyond(path: str) -> str:
    """A table of runs beyond those of training, with two models in the subspace on the same."""
    keys = {
        'soil_mm': 'soil, mm', 'force_l2': 'force', 'ok_share': 'frames `ok`',
        'ok_force_N': 'force off there, N', 'other_force_N': 'elsewhere, N',
        'still_mm': 'stay still, mm', 'mlp_driven_mm': '`mlp_driven`, mm',
        'mlp_driven_force_l2': 'its force', 'pcg_mm': '`pcg`, mm', 'pcg_force_l2': 'its force',
    }  # fmt: skip
    rows = files.read_json(path)['runs']
    lines = [(str(row['case']).removeprefix('path_'), *(row[key] for key in keys)) for row in rows]
    return markdown.table(('path', *keys.values()), lines)


_COLUMNS = {
    'soil_mm': 'soil, mm', 'still_mm': 'stay still, mm', 'force_l2': 'force',
    'held_force_l2': 'force held', 'torque_l2': 'torque', 'height_mm': 'height, mm',
    'held_height_mm': 'height held, mm', 'height_over_radius': 'height over radius',
    'penetration_mm': 'penetration before push-out, mm',
}  # fmt: skip
_STEADY = {
    'half_rate': 'soil error at half the rate, over that at the given rate',
    'double_rate': 'at twice the rate',
    'second_half_mm': 'second half of a run in one piece, mm',
    'restart_predicted_mm': 'begun anew half-way on the predicted bed, mm',
    'restart_true_mm': 'on the true bed, mm',
}


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('model_path', None, 'Model folder of a swept field.', required=True)
    flags.DEFINE_string('data_path', None, 'Dataset folder.', required=True)
    flags.DEFINE_enum('split', 'test', ['valid', 'test'], 'Runs that are judged.')
    flags.DEFINE_list('beside', [], 'NAME=FOLDER of other models for the same runs.')
    flags.DEFINE_string('output_path', None, 'JSON file to write.', required=True)
    flags.DEFINE_integer('num_threads', 2, 'CPU threads of TensorFlow.', lower_bound=1)


def main(values, _) -> None:
    """Runs the command."""
    from learning_to_simulate import api, checkpoints

    others = named_paths('beside', values.beside, 'FOLDER')
    model, data = api.TrainedModel(values.model_path), api.Dataset(values.data_path)
    stored = checkpoints.read_config(values.model_path)
    document = {
        'schema_version': SCHEMA_VERSION,
        **record.provenance(values.num_threads),
        'split': values.split,
        'config': stored['config'],
        'training': files.read_json(os.path.join(values.model_path, 'metrics.json'))['training'],
        'data_version': record.data_version(data.metadata),
        **measure(model, data, values.split),
    }
    for name, path in others.items():
        errors = errors_of(path, values.data_path, values.split)
        for row, found in zip(document['runs'], errors, strict=True):
            row |= {f'{name}_{key}': value for key, value in found.items()}
    files.write_json(values.output_path, document)
    print(by_kind(values.output_path))
    print(steady(values.output_path))
    print(f'wrote {values.output_path}')


if __name__ == '__main__':
    command.start(define_flags, main)
