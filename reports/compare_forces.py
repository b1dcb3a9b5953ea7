"""Compares the solver's blade force with the published records of the same cases.

A comparison to publish, not a target: the published solver's stiffness, contact and packing differ.

Examples:
    python -m reports compare_forces --original_path=DIR/Excavation_PCA \
        --raw_path=/tmp/raw/excavation
    python -m reports compare_forces --original_path=DIR/Wheel_PCA --raw_path=/tmp/raw/wheel \
        --scene=wheel --json=forces.json
"""

import os

import numpy as np
from absl import flags, logging

from mpm import raw_run, scenes
from pca_tools import files
from pca_tools.dataset import read_split
from reports import command, markdown

# Published cases in the order of the records; the validation file was divided in two.
_TRAIN_RECORDS = {'excavation': 8, 'wheel': 9}


def compare(ours: np.ndarray, theirs: np.ndarray) -> dict:
    """Returns mean, ratio of means, correlation and RMSE (N) of two force curves [T]."""
    return {
        'mean_ours_N': float(ours.mean()),
        'mean_published_N': float(theirs.mean()),
        'ratio': float(ours.mean() / theirs.mean()),
        'correlation': float(np.corrcoef(ours, theirs)[0, 1]),
        'rmse_N': float(np.sqrt(np.mean((ours - theirs) ** 2))),
    }


def published_forces(scene: scenes.Scene, original_path: str) -> dict[int, np.ndarray]:
    """Returns the published forces [T, 3] (N) by case number.

    Raises:
        ValueError: if the records are not the ones that the case numbers belong to, or hold no
            force.
    """
    count = _TRAIN_RECORDS[scene.name]
    found: dict[int, np.ndarray] = {}
    for split, cases in (('train', scene.published[:count]), ('valid', scene.published[count:])):
        records = read_split(original_path, split)
        if len(records) != len(cases):
            raise ValueError(
                f'{original_path}: {len(records)} records in {split}, case numbers are known '
                f'for {len(cases)}'
            )
        for case, record in zip(cases, records):
            if record.force is None:
                raise ValueError(f'{original_path}: records of {split} hold no force')
            found[case] = record.force
    return found


def compare_folder(scene: scenes.Scene, original_path: str, raw_path: str) -> list[dict]:
    """Returns one row per published case and force axis (x: drive, y: up).

    Raises:
        ValueError: see `published_forces`.
    """
    rows = []
    for case, force in published_forces(scene, original_path).items():
        path = os.path.join(raw_path, raw_run.file_name(case))
        if not os.path.exists(path):
            logging.warning('case %d has no run in %s', case, raw_path)
            continue
        run = raw_run.read_run(path)
        for axis, name in enumerate('xy'):
            rows.append({'case': case, 'axis': name} | compare(run.force[:, axis], force[:, axis]))
    return rows


def table(scene: scenes.Scene, rows: list[dict]) -> str:
    """A line per case and axis, then the means of each axis."""
    header = ('case', 'axis', 'mean ours N', 'published N', 'ratio', 'correlation', 'RMSE N',
              'parameters')  # fmt: skip
    lines = [
        (*row.values(), ', '.join(f'{v:g}' for v in scene.parameters(row['case']).values()))
        for row in rows
    ]
    for axis in 'xy':
        means = [
            np.mean([row[key] for row in rows if row['axis'] == axis])
            for key in ('mean_ours_N', 'mean_published_N')
            if rows
        ]
        if means:
            lines.append(('**all**', axis, *map(float, means), float(means[0] / means[1])))
    return markdown.table(header, lines, aligned=True)


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string(
        'original_path', None, 'Published dataset folder (train and valid).', required=True
    )
    flags.DEFINE_string('raw_path', None, 'Folder of our raw runs.', required=True)
    flags.DEFINE_enum('scene', 'excavation', sorted(scenes.SCENES), 'Which scene.')
    flags.DEFINE_string('json', None, 'Write the table to this file, too.')


def main(values, _) -> None:
    """Runs the command."""
    scene = scenes.scene_named(values.scene)
    rows = compare_folder(scene, values.original_path, values.raw_path)
    print(table(scene, rows))
    if values.json:
        files.write_json(values.json, rows)


if __name__ == '__main__':
    command.start(define_flags, main)
