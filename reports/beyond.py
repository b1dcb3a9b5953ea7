"""Whether the status of a soil field tells good frames from bad ones: runs that leave its data.

Each run of kind `beyond` (`mpm/motions/beyond.py`) but the usual one leaves in one way what fields
were taught. The shipped fields roll out these and the test runs of the data of record; the errors
of the frames that they flag stand beside those of frames that they do not.

No run drives a wheel backwards over fresh soil. A wheel is its own mirror image, so mirror images
of the test runs tell what a field is worth there.

Examples:
    python -m mpm.generate --scene=wheel --operator_seeds=0-10 --kinds=beyond --output_path=raw
    lts convert --raw_path=raw --like=datasets/wheel --output_path=datasets/wheel_beyond
    python -m reports beyond --output_path=docs/beyond.json
    python -m reports documents docs/results.md         # the table again, from the JSON
"""

import numpy as np
from absl import flags

import learning_to_simulate as lts
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.soil_field import runs as runs_lib
from pca_tools import dataset, files
from reports import markdown, record
from reports.protocol import judge
from reports.protocol.tables import TITLES, average

ERRORS = 'near_mm', 'force_relative_l2', 'drawbar_relative_l2', 'flagged_share'
# Scene -> the datasets whose test runs are compared with.
SCENES = {'excavation': ('excavation', 'excavation_wide'), 'wheel': ('wheel',)}


def rolled_out(evaluator, runs) -> tuple[list[dict], list[tuple]]:
    """Errors of each run, and what `judge.separation` takes."""
    from learning_to_simulate.soil_field import evaluation

    errors, frames = [], []
    for run in runs:
        rollout = evaluator.roll_out(run)
        flagged = np.array([status != RolloutStatus.OK for status in rollout.frame_status])
        frames.append((rollout.force[H:], run.force[H:], flagged[H:]))
        errors.append(evaluation.of_rollout(rollout, run))
    return errors, frames


def judged(scene: str) -> tuple[dict, dict]:
    """Runs of kind `beyond` with their errors, and `judge.separation` without and with them; errors
    of each test run of a wheel, forwards and mirrored ({} of a blade)."""
    from learning_to_simulate.soil_field import evaluation

    evaluator = evaluation.SoilEvaluator(lts.load(scene).model, under_load=False)
    usual = runs_lib.read_all([f'datasets/{data}' for data in SCENES[scene]], 'test')
    errors, frames = rolled_out(evaluator, usual)
    folder = f'datasets/{scene}_beyond'
    plots = {str(c['case']): c['plot'] for c in dataset.read_metadata(folder)['cases']['test']}
    beyond = runs_lib.read(folder, 'test')
    errors_beyond, frames_beyond = rolled_out(evaluator, beyond)
    kept = 'soil_mm', 'force_relative_l2', 'flagged_share'
    told = {'test runs': frames, 'with those beyond': frames + frames_beyond}
    found = {
        'runs': [
            {'run': plots[run.case], 'reason': row['status_reason']} | {k: row[k] for k in kept}
            for run, row in zip(beyond, errors_beyond, strict=True)
        ],
        'separation': {name: judge.separation(of) for name, of in told.items()},
    }
    if scene != 'wheel':
        return found, {}
    mirrored, _ = rolled_out(evaluator, [run.mirrored() for run in usual])
    ways = {'forwards': errors, 'backwards': mirrored}
    return found, {
        way: {key: [record.four(row[key]) for row in rows] for key in ERRORS}
        for way, rows in ways.items()
    }


def ways(path: str) -> str:
    """A wheel forwards and backwards: means over the runs, the median of the drawbar."""
    rows = []
    for way, of in files.read_json(path)['ways'].items():
        *figures, flagged = (average(key, of[key]) for key in ERRORS)
        name = f'wheel, {way} ({len(of[ERRORS[0]])} runs)'
        rows.append([name, *figures, f'{100 * flagged:.0f}'])
    titles = [TITLES[key] for key in ERRORS[:-1]]
    return markdown.table(['runs', *titles, 'frames flagged, %'], rows)


def separations(path: str) -> str:
    """Error of the force over the force, of frames that are flagged and of others."""
    rows = []
    for scene, found in files.read_json(path)['scenes'].items():
        for name, of in found['separation'].items():
            flagged, inside = of.get('error_flagged'), of['error_inside']  # none is flagged: None
            ratio = None if flagged is None else flagged / inside
            share = f'{100 * of["flagged_frames"]:.0f}'
            rows.append([f'{scene}: {name}', share, flagged, inside, ratio])
    header = 'runs', 'frames flagged, %', 'their error', 'of others', 'ratio'
    return markdown.table(header, rows)


def main(values) -> None:
    found: dict = record.provenance(1)
    found |= {'scenes': {}, 'ways': {}}
    for scene in SCENES:
        found['scenes'][scene], ways_of_scene = judged(scene)
        found['ways'] |= ways_of_scene
    files.write_json(values.output_path, found)
    print(*(made(values.output_path) for made in (separations, ways)), sep='\n\n')


def define_flags() -> None:
    flags.DEFINE_string('output_path', None, 'JSON file to write.', required=True)
