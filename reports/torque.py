"""The torque of models in a subspace beside their force, over the test runs of a dataset.

Models of `--predict_torque` are rolled out and judged by the protocol's own functions, beside what
knows nothing of the run: the torque held, the mean torque, and the model's force times the one
matrix that fits the training runs best.

Example:
    python -m reports.torque --data_path=datasets/excavation_v2 --model=mlp_driven=/models/a \\
        --model=mlp_driven=/models/b --work_path=/tmp/torque --output_path=docs/torque.json
    python -m reports documents docs/driving.md
"""

import dataclasses
import os

import numpy as np
from absl import flags

from pca_tools import dataset, files
from reports import command, markdown, record
from reports.protocol import rollouts, run_errors
from reports.protocol.truth import TruthReader

SPLIT = 'test'
QUANTITIES = {
    'soil_mm': 'soil, mm', 'force_l2': 'force', 'torque_l2': 'torque',
    'pitch_l2': 'torque in the plane of travel',
}  # fmt: skip
TRIVIAL = 'persistence', 'mean force'
FROM_FORCE = ', its force times a matrix'


def matrix_of(trajectories) -> np.ndarray:
    """float64 [3, 3], m: the matrix whose product with the force is nearest to the torque, over all
    frames of recorded runs; errors of a run count in units of its own torque, as they are judged.
    """
    forces, torques = [], []
    for run in trajectories:
        size = np.sqrt((run.torque.astype(np.float64) ** 2).mean())
        forces.append(run.force / size)
        torques.append(run.torque / size)
    return np.linalg.lstsq(np.concatenate(forces), np.concatenate(torques), rcond=None)[0].T


def judge(predictions, reader: TruthReader) -> list[dict]:
    """The errors of `QUANTITIES` that there are, of each run of the split in file order.

    Args:
      predictions: `run_errors.RunPrediction` of each run.
      reader: of the dataset.
    """
    indices = reader.indices(SPLIT)
    found = []
    for truth, prediction in zip(reader.read(SPLIT), predictions, strict=True):
        errors = run_errors.run_errors(prediction, truth, reader, indices)
        found.append({name: errors[name] for name in QUANTITIES if name in errors})
    return found


def table(path: str, protocol_path: str, *names: str) -> str:
    """Means over the runs, their range over seeds, as a table.

    Args:
      path: JSON of this report.
      protocol_path: JSON of `reports.protocol` on the same runs.
      names: its methods that are shown below, beside those that have the name of one of `path`,
        which are of the same model without a torque.

    Raises:
      ValueError: the two are not of the same test runs.
    """
    here, protocol = files.read_json(path), files.read_json(protocol_path)
    digests = [found['data']['sha256'][f'{SPLIT}.tfrecord'] for found in (here, protocol)]
    if digests[0] != digests[1]:
        raise ValueError(f'{path} and {protocol_path} judge other test runs')
    rows = [(name, seeds) for name, seeds in here['methods'].items()]
    others = {method['name']: method['seeds'] for method in protocol['methods']}
    without = [name for name in others if name in here['methods'] and name not in TRIVIAL]
    for name in (*without, *names):
        title = f'{name}, trained without torque' if name in without else name
        rows.append((title, [seed['runs'][SPLIT] for seed in others[name]]))
    return markdown.table(['method', *QUANTITIES.values()], [_row(*row) for row in rows])


def _row(name, seeds):
    cells = [
        markdown.span([np.mean([run[key] for run in seed]) for seed in seeds])
        if key in seeds[0][0]
        else ''
        for key in QUANTITIES
    ]
    return [name if len(seeds) == 1 else f'{name} ({len(seeds)} seeds)', *cells]


def main(values, _) -> None:
    """Runs the command."""
    from reports.protocol import baselines  # loads TensorFlow, and --help does not wait for it

    reader = TruthReader(values.data_path)
    methods: dict[str, list] = {}
    for baseline in (b for b in baselines.trivial(reader) if b.name in TRIVIAL):
        methods[baseline.name] = [judge(baselines.predictions(baseline, reader, SPLIT), reader)]
    matrix = matrix_of(dataset.read_split(values.data_path, 'train'))
    count = len(dataset.read_split(values.data_path, SPLIT))
    for item in values.model:
        name, _, folder = item.partition('=')
        if not folder:
            raise ValueError(f'--model={item}: NAME=FOLDER was expected')
        rolled = rollouts.roll_out(values.data_path, folder, SPLIT, values.work_path)
        predictions = rollouts.read(rolled, SPLIT, count, reader.metadata)
        methods.setdefault(name, []).append(judge(predictions, reader))
        from_force = [
            dataclasses.replace(p, modes=None, torque=p.force @ matrix.T) for p in predictions
        ]
        of_force = judge(from_force, reader)
        methods.setdefault(name + FROM_FORCE, []).append(of_force)
        print(f'{item}: judged', flush=True)
    result = {
        **record.provenance(),
        'data': {
            'path': os.path.basename(os.path.normpath(values.data_path)),
            'runs': count,
            'sha256': {
                f'{SPLIT}.tfrecord': files.sha256_of_file(
                    dataset.split_path(values.data_path, SPLIT)
                )
            },
        },
        'matrix_m': matrix.tolist(),
        'methods': methods,
    }
    files.write_json(values.output_path, result, indent=0)
    print(f'wrote {values.output_path}')


def define_flags() -> None:
    """Defines the flags."""
    flags.DEFINE_string('data_path', None, 'Dataset folder with torques.', required=True)
    flags.DEFINE_multi_string('model', [], 'NAME=FOLDER; folders of one name are its seeds.')
    flags.DEFINE_string('work_path', None, 'Folder for rollouts; calls resume.', required=True)
    flags.DEFINE_string('output_path', None, 'JSON file to write.', required=True)


if __name__ == '__main__':
    command.start(define_flags, main)
