"""Exports a trained model so that it runs without this project: SavedModel, LiteRT or ONNX.

A SavedModel has flat signatures: `step` (the last H frames and the body's coming pose in; modes,
force and body out) and `reconstruct` (modes in, soil particles out). LiteRT and ONNX have no
float64 worth using, so their `step` carries the state itself: float32 offsets from `origin` and
float32 velocities. A swept field has the same functions in all three, see
`field_functions`. `export.json` beside the model says what every input and output is. What was
written is loaded again and compared with the source model on recorded runs; beyond round-off the
export is refused.
"""

import os
import time

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from pca_tools import files, subspace

DESCRIPTION_FILE = 'export.json'
# Largest difference of one step to the source model, as a share of the largest motion or force of
# the compared frames. Measured 4e-7 (excavation) and 2e-6 (wheel): float32 sums in another order.
TOLERANCE = 1e-4
# Metres; float32 positions of a metre resolve 1e-7.
RECONSTRUCT_TOLERANCE = 2e-6
COMPARED_STEPS = 8
FORMATS = ('savedmodel', 'tflite', 'onnx')


def export(
    model_path: str,
    data_path: str,
    output_path: str,
    kind: str,
    n_rigid: int | None = None,
    members: int | None = None,
    n_particles: int | None = None,
) -> dict:
    """Writes an exported model, compares it with its source and describes it.

    Args:
      model_path: trained model.
      data_path: its dataset; gives runs to compare on and the subspace.
      output_path: folder to write; must be absent or empty.
      kind: one of `FORMATS`.
      n_rigid: R of the exported graph, for data with bodies of several sizes; None for the largest.
      members: of a swept field, networks that answer; None for all.
      n_particles: of a swept field, P of its `particles`; None for those of its bed at rest.

    Returns:
      the description that is also in `export.json`.

    Raises:
      ValueError: a scene that the format cannot hold, a model that does not fit the data, an
        absent converter, or outputs beyond the tolerance; nothing is left in `output_path`.
    """
    from learning_to_simulate import checkpoints, registry
    from learning_to_simulate.export import export_formats, field_exporting

    if os.path.exists(output_path) and (not os.path.isdir(output_path) or os.listdir(output_path)):
        raise ValueError(f'{output_path}: is there and not empty; nothing was written')
    if registry.of_folder(model_path).live:
        if n_rigid is not None:
            raise ValueError(f'n_rigid is {n_rigid}: a swept field has no rigid nodes')
        functions, write_and_compare = field_exporting.open_field(
            model_path, data_path, members, n_particles
        )
    else:
        if (members, n_particles) != (None, None):
            raise ValueError('members and n_particles are those of a swept field')
        functions, write_and_compare = _open_simulator(model_path, data_path, n_rigid)
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
        description['compared'] = write_and_compare(loaded, kind, folder)
        files.write_json(os.path.join(folder, DESCRIPTION_FILE), description)

    files.write_folder_atomically(output_path, fill)
    return description


def _open_simulator(model_path, data_path, n_rigid):
    """The functions of a model in a subspace, and what compares them as they were written."""
    from learning_to_simulate import registry
    from learning_to_simulate.export import step_functions

    opened = registry.open_model(model_path, data_path, 'test')
    model = opened.model
    by_size = {group.n_rigid: group for group in opened.groups}
    n_rigid = max(by_size) if n_rigid is None else n_rigid
    if n_rigid not in by_size:
        raise ValueError(
            f'{data_path}: no test run has {n_rigid} rigid nodes, there are {sorted(by_size)}'
        )
    space = _read_subspace(data_path, model)
    functions = step_functions.StepFunctions(model.simulator, model.layout(n_rigid), space)
    group = by_size[n_rigid].select(0)
    return functions, lambda loaded, kind, _: _compare(functions, loaded, kind, group, space)


def _read_subspace(data_path, model):
    path = os.path.join(data_path, 'subspace.npz')
    if not os.path.exists(path):
        return None
    return model.fitting_subspace(subspace.Subspace.load(path))


def _compare(functions, loaded, kind, group, space):
    """Differences to the source over steps from recorded histories, and times per call.

    Raises:
      ValueError: a difference above the tolerance, or outputs that are not finite.
    """
    n = functions.layout.n_rigid
    n_frame = group.position.shape[1]
    moved, expected, seconds = [], [], []
    found = {}  # name of a load -> pairs of exported and source
    for k in np.linspace(H, n_frame - 1, COMPARED_STEPS).astype(int):
        inputs = functions.inputs(kind, group, k)
        start = time.perf_counter()
        outputs = {name: np.asarray(value) for name, value in loaded['step'](**inputs).items()}
        seconds.append(time.perf_counter() - start)
        before = group.position[0, k - 1]
        if kind == 'savedmodel':
            moved.append(outputs['next_position'] - before)
        else:
            moved.append(outputs[functions.output_name(kind, 'velocity')][:, -1])
        velocity, of_source = functions.source_step(group, k)
        expected.append(velocity)
        for name, load in of_source.items():
            pair = outputs[functions.output_name(kind, name)], load
            found.setdefault(name, []).append(pair)
    differences = {'modes': _difference(moved, expected, slice(n, None))}
    if n:
        differences['rigid'] = _difference(moved, expected, slice(n))
    for name, pairs in found.items():
        differences[name] = _difference(*zip(*pairs), slice(None))
    values = {
        'steps': COMPARED_STEPS,
        'relative_difference': differences,
        'tolerance': TOLERANCE,
        'first_call_s': seconds[0],
        'ms_per_step_median': 1e3 * float(np.median(seconds[1:])),
    }
    bad = {name: d for name, d in differences.items() if not d <= TOLERANCE}
    if 'reconstruct' in loaded:
        modes = group.position[0, :, n:]

        def reconstruct(scores):
            return np.asarray(loaded['reconstruct'](modes=scores)['particles'])

        particles = [reconstruct(modes[k]) for k in (0, n_frame - 1)]
        apart = max(
            float(np.abs(p - space.decode(modes[k])).max())
            for p, k in zip(particles, (0, n_frame - 1))
        )
        values |= {'particles_difference_m': apart, 'particles_tolerance_m': RECONSTRUCT_TOLERANCE}
        start = time.perf_counter()
        for frame in modes[:COMPARED_STEPS]:
            reconstruct(frame)
        values['ms_per_reconstruction'] = 1e3 * (time.perf_counter() - start) / COMPARED_STEPS
        if not apart <= RECONSTRUCT_TOLERANCE:
            bad['particles_m'] = apart
    if bad:
        raise ValueError(
            f'the exported model differs from its source by {bad}, more than {TOLERANCE:g} of the '
            f'largest motion or {RECONSTRUCT_TOLERANCE:g} m; nothing was written'
        )
    return values


def _difference(values, expected, part):
    """Largest difference over the largest magnitude; 0 / 0 counts as 0."""
    a, b = (np.stack(x).astype(np.float64)[:, part] for x in (values, expected))
    apart, size = np.abs(a - b).max(), np.abs(b).max()
    return float(apart / size) if size > 0 else float(apart)
