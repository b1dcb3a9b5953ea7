"""Exports a trained model so that it runs without this project: SavedModel, LiteRT or ONNX.

A SavedModel has flat signatures: `step` (the last H frames and the body's coming pose in; modes,
force and body out) and `reconstruct` (modes in, soil particles out). LiteRT and ONNX have no
float64 worth using, so their `step` carries the state itself: float32 offsets from `origin` and
float32 velocities. Of a swept field its two networks are exported, see `field_networks`.
`export.json` beside the model says what every input and output is. What was written is loaded again
and compared with the source model on recorded runs; beyond round-off the export is refused.
"""

import os
import time

from pca_tools import files

DESCRIPTION_FILE = 'export.json'
FORMATS = ('savedmodel', 'tflite', 'onnx')


def export(
    model_path: str,
    data_path: str,
    output_path: str,
    kind: str,
    n_rigid: int | None = None,
    n_particles: int | None = None,
) -> dict:
    """Writes an exported model, compares it with its source and describes it.

    Args:
      model_path: trained model.
      data_path: its dataset; gives runs to compare on and the subspace.
      output_path: folder to write; must be absent or empty.
      kind: one of `FORMATS`.
      n_rigid: R of the exported graph, for data with bodies of several sizes; None for the largest.
      n_particles: of a swept field, P of its `soil`; None for those of its bed at rest.

    Returns:
      the description that is also in `export.json`.

    Raises:
      ValueError: a scene that the format cannot hold, a model that does not fit the data, an
        absent converter, or outputs beyond the tolerance; nothing is left in `output_path`.
    """
    from learning_to_simulate import checkpoints, registry
    from learning_to_simulate.export import export_formats
    from learning_to_simulate.export.field_networks import FieldNetworks
    from learning_to_simulate.export.step_functions import StepFunctions

    if os.path.exists(output_path) and (not os.path.isdir(output_path) or os.listdir(output_path)):
        raise ValueError(f'{output_path}: is there and not empty; nothing was written')
    if registry.of_folder(model_path).live:
        if n_rigid is not None:
            raise ValueError(f'n_rigid is {n_rigid}: a swept field has no rigid nodes')
        functions = FieldNetworks(model_path, data_path, n_particles)
    else:
        if n_particles is not None:
            raise ValueError('n_particles is for a swept field')
        functions = StepFunctions.of_dataset(model_path, data_path, n_rigid)
    description = {}

    def fill(folder):
        concrete = functions.concrete(kind)
        load = export_formats.WRITERS[kind](concrete, functions.variables, folder)
        description.update(functions.describe(kind))
        weights = os.path.join(model_path, checkpoints.WEIGHTS_FILE)
        description['weights_sha256'] = files.sha256_of_file(weights)
        start = time.perf_counter()
        loaded = load()
        description['load_s'] = time.perf_counter() - start
        description['compared'] = functions.compare(loaded, kind, folder)
        files.write_json(os.path.join(folder, DESCRIPTION_FILE), description)

    files.write_folder_atomically(output_path, fill)
    return description
