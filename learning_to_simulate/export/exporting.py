"""Exports a trained model so that it runs without this project: SavedModel, LiteRT or ONNX.

Exported are functions of arrays without memory: of a model in a subspace `step` and `reconstruct`
(`step_functions`), of a swept field its two networks (`field_networks`). `export.json` beside the
model says what every input and output is, and `sample.npz` holds calls to check another program
with. What was written is loaded again and compared with the source model on a recorded run; beyond
round-off the export is refused.
"""

import os
import time

import numpy as np

from pca_tools import files

DESCRIPTION_FILE, SAMPLE_FILE = 'export.json', 'sample.npz'
FORMATS = ('savedmodel', 'tflite', 'onnx')
# Largest difference to the source as a share of the largest motion or load of the compared calls.
# Measured 4e-7 (excavation) to 2e-6 (wheel, fields): float32 sums in another order.
TOLERANCE = 1e-4
# Of particles, m; float32 positions of a metre resolve 1e-7.
PARTICLES_TOLERANCE = 2e-6


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
      data_path: its dataset; gives a run to compare on.
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
        exported = FieldNetworks(model_path, data_path, n_particles)
    else:
        if n_particles is not None:
            raise ValueError('n_particles is for a swept field')
        exported = StepFunctions.of_dataset(model_path, data_path, n_rigid)
    functions = exported.functions(kind)
    concrete = export_formats.concrete(functions, kind)
    weights = os.path.join(model_path, checkpoints.WEIGHTS_FILE)

    def rows(tensors):
        return {k: [list(t.shape), t.dtype.name, exported.meaning[k]] for k, t in tensors.items()}

    description = {
        'format': kind,
        'signatures': {
            name: {'inputs': rows(functions[name][1]), 'outputs': rows(found.structured_outputs)}
            for name, found in concrete.items()
        },
        'weights_sha256': files.sha256_of_file(weights),
        **exported.describe(),
    }

    def fill(folder):
        load = export_formats.WRITERS[kind](concrete, exported.variables, folder)
        start = time.perf_counter()
        loaded = load()
        description['load_s'] = time.perf_counter() - start
        samples = exported.samples()
        description['compared'] = compare(exported, loaded, samples)
        arrays: dict[str, np.ndarray] = {}
        for calls in samples.values():
            rows = [inputs | outputs for inputs, outputs in calls]
            arrays = {name: np.stack([row[name] for row in rows]) for name in rows[0]} | arrays
        files.write_npz(os.path.join(folder, SAMPLE_FILE), **arrays)
        files.write_json(os.path.join(folder, DESCRIPTION_FILE), description)

    files.write_folder_atomically(output_path, fill)
    return description


def compare(exported, loaded, samples) -> dict:
    """Differences of loaded functions to their source, and times per call.

    Args:
      exported: has `parts(outputs)`: what is compared, by name; particles, m, as `particles_m`.
      loaded: name -> function of arrays.
      samples: name -> calls, (inputs, outputs of the source).

    Raises:
      ValueError: a difference above its tolerance, or outputs that are not finite.
    """
    shares, milliseconds, particles = {}, {}, 0.0
    for function, calls in samples.items():
        seconds, pairs = [], {}
        for inputs, expected in calls:
            clock = time.perf_counter()
            found = {k: np.asarray(v) for k, v in loaded[function](**inputs).items()}
            seconds.append(time.perf_counter() - clock)
            parts = exported.parts(found), exported.parts(expected)
            for name in parts[1]:
                pairs.setdefault(name, []).append([np.asarray(p[name], np.float64) for p in parts])
        milliseconds[function] = 1e3 * float(np.median(seconds[1:]))
        for name, values in pairs.items():
            one, other = (np.stack(column) for column in zip(*values))
            apart, size = float(np.abs(one - other).max()), float(np.abs(other).max())
            if name == 'particles_m':
                particles = apart
            else:
                shares[name] = apart / size if size > 0 else apart
    bad = {name: share for name, share in shares.items() if not share <= TOLERANCE}
    if not particles <= PARTICLES_TOLERANCE:
        bad['particles_m'] = particles
    if bad:
        raise ValueError(
            f'the exported model differs from its source by {bad}, more than {TOLERANCE:g} of the '
            f'largest motion or load or {PARTICLES_TOLERANCE:g} m; nothing was written'
        )
    return {
        'calls': len(calls),
        'relative_difference': shares,
        'tolerance': TOLERANCE,
        'particles_difference_m': particles,
        'particles_tolerance_m': PARTICLES_TOLERANCE,
        'ms_per_call': milliseconds,
    }
