"""Exports a trained model so that it runs without this project: SavedModel, LiteRT, ONNX, C, FMU.

To TensorFlow's relatives go functions of arrays without memory: of a model in a subspace `step` and
`reconstruct` (`step_functions`). In C and as an FMU a model keeps its state (`native.exporting`); a
soil field has no other form. `export.json` beside the model says what every input and output is,
and `sample.npz` holds calls of functions to check another program with. What was written is loaded
again and compared with the source model on a recorded run; beyond round-off the export is refused.
"""

import os

from learning_to_simulate import checkpoints, native, registry
from pca_tools import files

FORMATS = ('savedmodel', 'tflite', 'onnx', *native.FORMATS)


def export(
    model_path: str,
    data_path: str,
    output_path: str,
    kind: str,
    n_tools: int | None = None,
) -> dict:
    """Writes an exported model, compares it with its source and describes it.

    Args:
      model_path: trained model.
      data_path: its dataset; gives a run to compare on.
      output_path: folder to write; must be absent or empty.
      kind: one of `FORMATS`.
      n_tools: of a soil field as an FMU, how many tools work on its terrain; None for one.

    Returns:
      the description that is also in `export.json`.

    Raises:
      ValueError: a model or a scene that the format cannot hold, a model that does not fit the
        data, an absent converter, C that does not compile, or outputs beyond the tolerance;
        nothing is left in `output_path`.
      FileNotFoundError: no model or dataset there.
    """
    if os.path.exists(output_path) and (not os.path.isdir(output_path) or os.listdir(output_path)):
        raise ValueError(f'{output_path}: is there and not empty; nothing was written')
    exported = _exported(model_path, data_path, kind, n_tools)
    weights = os.path.join(model_path, checkpoints.WEIGHTS_FILE)
    description = {
        'format': kind,
        'weights_sha256': files.sha256_of_file(weights),
        **exported.describe(),
    }

    def fill(folder):
        description.update(exported.write(kind, folder))
        files.write_json(os.path.join(folder, 'export.json'), description)

    files.write_folder_atomically(output_path, fill)
    return description


def _exported(model_path, data_path, kind, n_tools):
    method = registry.of_folder(model_path)
    if method.on_terrain:
        if kind not in native.FORMATS:
            raise ValueError(f'{model_path}: a soil field has --format=c and fmu')
        if n_tools is not None and kind != 'fmu':
            raise ValueError(f'n_tools is {n_tools}: in C each tool has an instance of its own')
        from learning_to_simulate.native.exporting import CSoilField

        return CSoilField(model_path, data_path, n_tools or 1)
    if n_tools is not None:
        raise ValueError(f'n_tools is {n_tools}: only a soil field has several tools on a terrain')
    if kind == 'fmu':
        raise ValueError(f'{model_path}: only a soil field has --format=fmu')
    if not method.steps:
        raise ValueError(f'{model_path}: a method without steps has no exported form')
    if kind == 'c':
        from learning_to_simulate.native.exporting import CModel

        return CModel(model_path, data_path)
    from learning_to_simulate.export.step_functions import StepFunctions

    return StepFunctions(model_path, data_path)


def summary(description: dict, output_path: str) -> str:
    """What was written and how it compares, for the terminal."""
    compared = description['compared']
    what = f'signatures {", ".join(description.get("signatures", ()))}'
    if 'symbol' in description:
        what = f'model {description["symbol"]}, digest {description["digest"][:12]}'
    wrote = f'wrote {output_path} ({description["format"]}, {what})\n'
    if 'skipped' in compared:
        return f'{wrote}not compared with TensorFlow: {compared["skipped"]}'
    apart = ', '.join(f'{k} {v:.2g}' for k, v in compared['relative_difference'].items())
    times = [f'{name} {ms:.3g} ms' for name, ms in compared.get('ms_per_call', {}).items()]
    places = ', '.join(
        f'{name} {compared[f"{name}_difference_m"]:.2g} m'
        for name in ('particles', 'heights')
        if f'{name}_difference_m' in compared
    )
    return (
        f'{wrote}largest difference to the source over {compared["calls"]} calls: {apart} (allowed '
        f'{compared["tolerance"]:g}), {places}\n'
        f'{", ".join(times) or compared["engine"]}'
    )
