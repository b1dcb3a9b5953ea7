"""Compares the solver's blade force with the published records of the same cases.

A comparison to publish, not a target: the published solver's stiffness, contact and packing differ.

Examples:
    python -m reports compare_forces --original_path=DIR/Excavation_PCA \
        --raw_path=/tmp/raw/excavation
    python -m reports compare_forces --original_path=DIR/Wheel_PCA --raw_path=/tmp/raw/wheel \
        --scene=wheel --json=forces.json
"""

import json
import os
import sys

import numpy as np
from absl import app, flags, logging

from mpm import raw_run, scenes
from pca_tools.dataset import read_split

_ORIGINAL_PATH = flags.DEFINE_string(
    'original_path', None, 'Published dataset folder (train and valid).', required=True
)
_RAW_PATH = flags.DEFINE_string('raw_path', None, 'Folder of our raw runs.', required=True)
_SCENE = flags.DEFINE_enum('scene', 'excavation', sorted(scenes.SCENES), 'Which scene.')
_JSON = flags.DEFINE_string('json', None, 'Write the table to this file, too.')

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


def compare_folder(scene: scenes.Scene, original_path: str, raw_path: str) -> list[dict]:
    """Returns one row per published case and force axis (x: drive, y: up).

    Raises:
        ValueError: if the records are not the ones that the case numbers belong to.
    """
    count = _TRAIN_RECORDS[scene.name]
    rows = []
    for split, cases in (('train', scene.published[:count]), ('valid', scene.published[count:])):
        records = read_split(original_path, split)
        if len(records) != len(cases):
            raise ValueError(
                f'{original_path}: {len(records)} records in {split}, case numbers are known '
                f'for {len(cases)}'
            )
        for case, record in zip(cases, records):
            path = os.path.join(raw_path, raw_run.file_name(case))
            if not os.path.exists(path):
                logging.warning('case %d has no run in %s', case, raw_path)
                continue
            run = raw_run.read_run(path)
            for axis, name in enumerate('xy'):
                rows.append(
                    {'case': case, 'axis': name}
                    | compare(run.force[:, axis], record.force[:, axis])
                )
    return rows


def main(argv):
    if len(argv) > 1:
        raise app.UsageError(f'unknown arguments: {argv[1:]}')
    scene = scenes.scene_named(_SCENE.value)
    try:
        rows = compare_folder(scene, _ORIGINAL_PATH.value, _RAW_PATH.value)
    except ValueError as error:
        logging.error('%s', error)
        sys.exit(1)
    print('case  axis  mean ours  published   ratio  correlation  RMSE (N)  parameters')
    for row in rows:
        parameters = ', '.join(f'{value:g}' for value in scene.parameters(row['case']).values())
        print(
            f'{row["case"]:4d}  {row["axis"]:>4}  {row["mean_ours_N"]:9.1f}  '
            f'{row["mean_published_N"]:9.1f}  {row["ratio"]:6.2f}  {row["correlation"]:11.2f}  '
            f'{row["rmse_N"]:8.1f}  {parameters}'
        )
    for axis in 'xy':
        ours = [row['mean_ours_N'] for row in rows if row['axis'] == axis]
        theirs = [row['mean_published_N'] for row in rows if row['axis'] == axis]
        if ours:
            print(
                f'{len(ours)} cases, axis {axis}: mean {np.mean(ours):.1f} N, published '
                f'{np.mean(theirs):.1f} N, ratio {np.mean(ours) / np.mean(theirs):.2f}'
            )
    if _JSON.value:
        with open(_JSON.value, 'w', encoding='utf-8') as file:
            json.dump(rows, file, indent=1)


if __name__ == '__main__':
    app.run(main)
