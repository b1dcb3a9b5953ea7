"""Model folders of swept fields: `config.json` and `weights.npz`, all that live use needs."""

import dataclasses
import os

import numpy as np

from learning_to_simulate import checkpoints, known_shapes
from learning_to_simulate.methods.swept_features import SweptGrid
from learning_to_simulate.methods.swept_field.axes import Axes
from learning_to_simulate.methods.swept_field.field import SweptField
from learning_to_simulate.methods.swept_field.settings import SweptFieldConfig
from learning_to_simulate.methods.swept_field.tools import TOOLS
from learning_to_simulate.scene import Scene
from pca_tools import files

_REST = 'bed/rest'


def _weights(field: SweptField) -> dict:
    """Name -> variable, the same in every process."""
    return {
        f'{name}/{i}/{kind}': variable
        for name, part in (('soil', field.network.soil), ('load', field.network.load))
        for i, layer in enumerate(part.layers)
        for kind, variable in zip(('weight', 'bias'), layer, strict=True)
    }


def save(path: str, field: SweptField, data: dict, written: dict | None = None) -> None:
    """Writes a model folder, config.json last: it says that the rest is there.

    Args:
      path: folder, present.
      field: the model.
      data: where its training data came from, for the record.
      written: of `resting_start.write`.

    Raises:
      ValueError: weights that are not finite; nothing is written.
    """
    arrays = {name: v.numpy() for name, v in _weights(field).items()}
    if bad := [name for name, v in arrays.items() if not np.isfinite(v).all()]:
        raise ValueError(f'{path}: not saved, weights are not finite: {bad[:3]}')
    arrays[_REST] = field.rest.astype(np.float32)
    files.write_npz(os.path.join(path, checkpoints.WEIGHTS_FILE), **arrays)
    files.write_json(
        os.path.join(path, checkpoints.CONFIG_FILE),
        {
            'schema_version': checkpoints.SCHEMA_VERSION,
            'config': dataclasses.asdict(field.config),
            'scene': field.scene.to_json(),
            'field': {
                'axes': dataclasses.asdict(field.axes),
                'grid': dataclasses.asdict(field.grid),
                field.tool.name: dataclasses.asdict(field.tool),
                'kept_spacing': field.kept_spacing,
                'spacing': field.spacing,
                'ranges': field.ranges,
                'calibration': field.calibration,
            },
            'data': data,
            'files': written or {},
        },
    )


def load(path: str) -> SweptField:
    """Reads a model folder.

    Raises:
      FileNotFoundError: no model there.
      ValueError: a damaged one, or one of another method.
    """
    stored = checkpoints.read_config(path)
    where = os.path.join(path, checkpoints.CONFIG_FILE)
    weights_path = os.path.join(path, checkpoints.WEIGHTS_FILE)
    try:
        config = SweptFieldConfig(**stored['config'])
        scene = Scene.from_json(stored['scene'])
        values = stored['field']
        parts = {
            'axes': Axes(**values['axes']),
            'grid': SweptGrid(**values['grid']),
            'tool': next(t(**values[n]) for n, t in TOOLS.items() if n in values),
            'kept_spacing': float(values['kept_spacing']),
            'spacing': float(values['spacing']),
            'ranges': _ranges(values['ranges']),
            'calibration': {k: [float(x) for x in v] for k, v in values['calibration'].items()},
        }
    except (KeyError, TypeError, ValueError, AttributeError, StopIteration) as error:
        raise ValueError(f'{where}: a field is missing, unknown or wrong ({error!r})') from error
    arrays = checkpoints.stored_weights(path)
    with known_shapes.only((w.shape for w in arrays.values()), weights_path):
        field = SweptField(config, scene, rest=np.zeros((0, 3)), **parts)
    variables = _weights(field)
    shapes = {name: tuple(v.shape) for name, v in variables.items()}
    checkpoints.check_weights(path, arrays, shapes | {_REST: _rest_shape(arrays)})
    for name, variable in variables.items():
        variable.assign(arrays[name])
    field.rest = arrays[_REST].astype(np.float64)
    return field


def _ranges(stored):
    ranges = {name: [float(x) for x in limits] for name, limits in stored.items()}
    # Written before the room was judged: all that its two ends allow.
    (least, most), (first, last) = ranges['end'], ranges['foremost']
    return ranges | {'room': ranges.get('room', [least - last, most - first])}


def _rest_shape(arrays):
    """[N, 3] of the stored bed; any N fits."""
    shape = arrays.get(_REST, np.zeros((0, 3))).shape
    return shape if len(shape) == 2 and shape[1] == 3 else (0, 3)
