"""Exports a trained model as a C project (`--format=c`) or as an FMU (`--format=fmu`).

What was written is compiled, run over a recorded test run and compared with the TensorFlow stepper;
beyond round-off the export is refused.

Examples:
  python -m learning_to_simulate.export_c.exporting --format=c --model_path=models/excavation/pcg \\
      --data_path=datasets/excavation --output_path=/tmp/soil
"""

import os
import sys
import tempfile

import numpy as np
from absl import app, flags

from learning_to_simulate import checkpoints
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.export_c import c_library, fmu, model_data, project, starts
from learning_to_simulate.export_c.c_soil import CSoil
from learning_to_simulate.live import stepping
from learning_to_simulate.methods import registry
from pca_tools import files

DESCRIPTION_FILE = 'export.json'
# Largest difference to the TensorFlow stepper as a share of the motion, or of the largest force, of
# the compared frames. Measured 1e-7 to 3e-6 on the shipped models.
TOLERANCE = 1e-4
COMPARED_STEPS = 40
FORMATS = ('c', 'fmu')


def export(model_path: str, data_path: str, output_path: str, kind: str, n_rigid=None) -> dict:
    """Writes an exported model, compares it with its source and describes it.

    Args:
      model_path: trained model.
      data_path: its dataset; gives starts, the run to compare on and the subspace.
      output_path: folder to write; must be absent or empty.
      kind: 'c' or 'fmu'.
      n_rigid: R of the exported graph; None for that of the model's first training run.

    Returns:
      the description that is also in `export.json`.

    Raises:
      ValueError: a model that has no C form, a dataset that it does not fit, or outputs beyond the
        tolerance; nothing is left in `output_path`.
      FileNotFoundError: no model or dataset there.
    """
    if os.path.exists(output_path) and (not os.path.isdir(output_path) or os.listdir(output_path)):
        raise ValueError(f'{output_path}: is there and not empty; nothing was written')
    model, n_rigid, subspace, found = starts.read_model(model_path, data_path, n_rigid)
    values = model_data.values(model, n_rigid, subspace, starts=found)
    name = project.symbol(model_path)
    description = {
        'format': kind,
        'symbol': name,
        'digest': values['digest'],
        'scene': model.simulator.scene.to_json(),
        'n_rigid': n_rigid,
        'starts': len(found),
        'weights_sha256': files.sha256_of_file(os.path.join(model_path, checkpoints.WEIGHTS_FILE)),
        'compared': _compare(model_path, data_path, model, n_rigid, subspace, name, values),
    }

    def fill(folder):
        if kind == 'fmu':
            fmu.write(os.path.join(folder, f'{name}.fmu'), name, values)
        else:
            project.write(folder, name, values)
        files.write_json(os.path.join(folder, DESCRIPTION_FILE), description)

    files.write_folder_atomically(output_path, fill)
    return description


def _compare(model_path, data_path, model, n_rigid, subspace, name, values):
    """Differences of the compiled project to the TensorFlow stepper over recorded frames.

    Raises:
      ValueError: a difference above the tolerance.
    """
    opened = registry.open_model(model_path, data_path, 'test')
    groups = opened.groups
    group = next((g for g in groups if g.n_rigid == n_rigid), None)
    if group is None:
        return {'skipped': f'no test run has {n_rigid} rigid nodes'}
    with tempfile.TemporaryDirectory() as folder:
        project.write(folder, name, values)
        library = os.path.join(folder, 'model.so')
        try:
            c_library.compile_sources(library, folder)
        except c_library.NoCompiler as error:
            return {'skipped': str(error)}
        soil = CSoil.open(library, name)
    steppers = soil, stepping.Stepper(model, n_rigid, subspace)
    nodes, forces, particles = ([], []), ([], []), []
    known = model.simulator.scene.rigid_motion.is_known
    for stepper in steppers:
        stepper.reset(group.position[0, :H], group.context_at(H, 0))
    poses = group.position[0, H : H + COMPARED_STEPS, :n_rigid]
    for k, pose in enumerate(poses, H):
        context = group.context_at(k, 0) if group.context_changes else None
        for stepper, of_nodes, of_force in zip(steppers, nodes, forces):
            frame = stepper.step(pose if known else None, context)
            of_nodes.append(np.concatenate([frame.rigid_pose, frame.modes]))
            of_force.append(np.zeros(3) if frame.force is None else frame.force)
        if subspace is not None:
            particles.append(np.abs(np.subtract(*(s.particles() for s in steppers))).max())
    difference = {
        'position': _share(*nodes, group.position[0, H - 1]),
        'force': _share(*forces, 0.0),
    }
    bad = {k: v for k, v in difference.items() if not v <= TOLERANCE}
    if bad:
        raise ValueError(
            f'the C code differs from the model by {bad}, more than {TOLERANCE:g} of the motion or '
            f'force; nothing was written'
        )
    return {
        'steps': len(nodes[0]),
        'kernel': soil.kernel,
        'relative_difference': difference,
        'tolerance': TOLERANCE,
        'particles_difference_m': float(max(particles, default=0.0)),
    }


def _share(values, expected, start):
    """Largest difference over the largest distance from the start; 0 / 0 counts as 0."""
    apart = np.abs(np.subtract(values, expected)).max()
    size = np.abs(np.subtract(expected, start)).max()
    return float(apart / size) if size > 0 else float(apart)


def summary(description: dict, output_path: str) -> str:
    """What was written and how it compares, for the terminal."""
    compared = description['compared']
    lines = [
        f'wrote {output_path} ({description["format"]}, model {description["symbol"]}, '
        f'{description["starts"]} starts, digest {description["digest"][:12]})'
    ]
    if 'skipped' in compared:
        return '\n'.join([*lines, f'not compared with TensorFlow: {compared["skipped"]}'])
    apart = ', '.join(f'{k} {v:.2g}' for k, v in compared['relative_difference'].items())
    lines.append(
        f'largest difference to TensorFlow over {compared["steps"]} steps: {apart} (allowed '
        f'{compared["tolerance"]:g}), particles {compared["particles_difference_m"]:.2g} m; kernel '
        f'{compared["kernel"]}'
    )
    return '\n'.join(lines)


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('model_path', None, 'Trained model.', required=True)
    flags.DEFINE_string('data_path', None, 'Dataset folder of the model.', required=True)
    flags.DEFINE_string('output_path', None, 'Folder to write; absent or empty.', required=True)
    flags.DEFINE_enum('format', 'c', FORMATS, 'What to write.')
    flags.DEFINE_integer('n_rigid', None, 'Rigid nodes of the graph; default: as trained.', 0)


def main(_) -> None:
    """Runs the command."""
    v = flags.FLAGS
    try:
        description = export(v.model_path, v.data_path, v.output_path, v.format, v.n_rigid)
    except (ValueError, OSError, c_library.NoCompiler) as error:
        sys.exit(f'error: {files.printable(error)}')
    print(summary(description, v.output_path))


if __name__ == '__main__':
    define_flags()
    app.run(main)
