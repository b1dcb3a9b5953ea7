"""Exports a trained model as a C project or an FMU, for `learning_to_simulate.export`.

What was written is compiled, run over a recorded test run and compared with the TensorFlow stepper;
beyond round-off the export is refused.
"""

import os

from learning_to_simulate import checkpoints
from learning_to_simulate.native import agreement, fmu, project
from pca_tools import files

DESCRIPTION_FILE = 'export.json'


def export(model_path: str, data_path: str, output_path: str, kind: str, n_rigid=None) -> dict:
    """Writes an exported model, compares it with its source and describes it.

    Args:
      model_path: trained model.
      data_path: its dataset; gives the run to compare on.
      output_path: folder to write; must be absent or empty.
      kind: one of `native.FORMATS`.
      n_rigid: R of the exported graph; None for that of the model's first start.

    Returns:
      the description that is also in `export.json`.

    Raises:
      ValueError: a model that has no C form, a dataset that it does not fit, C that does not
        compile, or outputs beyond the tolerance; nothing is left in `output_path`.
      FileNotFoundError: no model or dataset there.
    """
    if os.path.exists(output_path) and (not os.path.isdir(output_path) or os.listdir(output_path)):
        raise ValueError(f'{output_path}: is there and not empty; nothing was written')
    name, opened = project.symbol(model_path), agreement.Opened.of(model_path, n_rigid)
    values = opened.values()
    description = {
        'format': kind,
        'symbol': name,
        'digest': values['digest'],
        'weights_sha256': files.sha256_of_file(os.path.join(model_path, checkpoints.WEIGHTS_FILE)),
        'scene': opened.model.simulator.scene.to_json(),
        'compared': agreement.of_project(model_path, data_path, name, opened),
    }
    for key in ('n_rigid', 'n_start', 'n_member'):
        if key in values:
            description[key] = values[key]

    def fill(folder):
        if kind == 'fmu':
            fmu.write(os.path.join(folder, f'{name}.fmu'), name, values)
        else:
            project.write(folder, name, values)
        files.write_json(os.path.join(folder, DESCRIPTION_FILE), description)

    files.write_folder_atomically(output_path, fill)
    return description


def summary(description: dict, output_path: str) -> str:
    """What was written and how it compares, for the terminal."""
    compared = description['compared']
    wrote = (
        f'wrote {output_path} ({description["format"]}, model {description["symbol"]}, '
        f'digest {description["digest"][:12]})\n'
    )
    if 'skipped' in compared:
        return f'{wrote}not compared with TensorFlow: {compared["skipped"]}'
    apart = ', '.join(f'{k} {v:.2g}' for k, v in compared['relative_difference'].items())
    return (
        f'{wrote}largest difference to TensorFlow over {compared["steps"]} steps: {apart} (allowed '
        f'{compared["tolerance"]:g}), particles {compared["particles_difference_m"]:.2g} m; '
        f'{compared["engine"]}'
    )
