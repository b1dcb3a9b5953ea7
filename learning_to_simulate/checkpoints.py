"""Model folders: what a trained model is, on disk.

  config.json    the settings, scene, statistics, edges, data digest, package versions
  weights.npz    weights for evaluation (moving averages where the config has them): arrays only,
                 no code, no pickle
  start.npz, subspace.npz   what the model needs to run without its dataset (`live.starts`)
  ckpt-<step>.npz   weights, optimiser and averages, to resume training (`training.loop`)

A folder that ships with the project holds no checkpoints. What is here is the same for models of
all methods.
"""

import collections
import contextlib
import dataclasses
import hashlib
import importlib.metadata
import json
import os
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from learning_to_simulate.scene import Scene, is_int, require
from pca_tools import files
from pca_tools.storage import folder_lock

CONFIG_FILE, WEIGHTS_FILE = 'config.json', 'weights.npz'
START_FILE, SUBSPACE_FILE = 'start.npz', 'subspace.npz'
SCHEMA_VERSION = 1
NUM_PARTICLE_TYPES = 9  # of the published type embedding
# May lie in a folder that has no config.json yet: the lock, and what a training leaves that was
# killed while it wrote the folder's first files.
_FIRST = (folder_lock.LOCK_NAME, START_FILE, SUBSPACE_FILE)


def read_config(path: str) -> dict:
    """The checked config.json; FileNotFoundError if the folder holds no model, ValueError if the
    file is of another kind or version."""
    name = os.path.join(path, CONFIG_FILE)
    if not os.path.isfile(name):
        raise FileNotFoundError(
            f'{path}: holds no model (no {CONFIG_FILE}); train one with --mode=train '
            f'--model_path={path}'
        )
    values = files.read_json(name)
    if not isinstance(values, dict) or values.get('schema_version') != SCHEMA_VERSION:
        raise ValueError(f'{name}: not a model config of schema version {SCHEMA_VERSION}')
    return values


@contextlib.contextmanager
def refusing_wrong_fields(path: str) -> Iterator[None]:
    """Turns what a field of a damaged or foreign `config.json` raises, where it is read, into a
    ValueError that names the file."""
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ValueError(
            f'{os.path.join(path, CONFIG_FILE)}: a field is missing, unknown or wrong ({error!r})'
        ) from error


def settings_and_scene(values: dict, settings: type) -> tuple:
    """The checked settings (of a class), scene and particle types of any model's `config.json`;
    raises as `refusing_wrong_fields` expects it."""
    config, scene = settings(**values['config']), Scene.from_json(values['scene'])
    modes = getattr(config, 'modes', 0)
    require(modes in (0, scene.n_modes), 'modes', modes)
    types = values['particle_types']
    is_pair = isinstance(types, list) and len(types) == 2
    known = is_pair and all(is_int(t, 0, NUM_PARTICLE_TYPES - 1) for t in types)
    require(known, 'particle_types', types)
    return config, scene, tuple(types)


def save_config(path: str, model, n_rigid: int, data: dict, files_beside=None) -> None:
    """Writes config.json of a model with `simulator`, masks of its edges and `edge_counts()`; any R
    that it runs on, where the training data came from, and name -> sha256 of what else it needs
    (`live.starts`)."""
    import tensorflow as tf

    s = model.simulator
    masks = {name: getattr(model, name) for name in ('mode_mask', 'loaded_mask')}
    packages = {n: importlib.metadata.version(n) for n in ('numpy', 'dm-sonnet', 'graph_nets')}
    values = {
        'schema_version': SCHEMA_VERSION,
        'config': dataclasses.asdict(s.config),
        'scene': s.scene.to_json(),
        'particle_types': list(s.particle_types),
        'n_rigid': n_rigid,
        'edge_source': model.edge_source,
        'edges': model.edge_counts(),
        **{n: None if mask is None else mask.astype(int).tolist() for n, mask in masks.items()},
        'statistics': s.statistics.to_json(),
        'data': data,
        'files': files_beside or {},
        'packages': packages | {'tensorflow': tf.__version__},
    }
    files.write_json(os.path.join(path, CONFIG_FILE), values)


def weights_of(model) -> dict:
    """Variables of a model's simulator by names that do not change between processes: their order
    and role."""
    named = enumerate(model.simulator.trainable_variables)
    return {f'{i:03d}.{v.name.split(":")[0]}': v for i, v in named}


def save_weights(path: str, variables: dict) -> None:
    """Writes variables by their names to weights.npz; ValueError if one is not finite: an older
    file stays."""
    values = {name: variable.numpy() for name, variable in variables.items()}
    if bad := [name for name, value in values.items() if not np.isfinite(value).all()]:
        raise ValueError(f'{path}: not saved, weights are not finite: {bad[:3]}')
    files.write_npz(os.path.join(path, WEIGHTS_FILE), **values)


@contextlib.contextmanager
def only_shapes(shapes: Iterable[tuple[int, ...]], source: str) -> Iterator[None]:
    """Lets a `with` block make trainable variables of the shapes of all arrays of a weights file
    (`source`), each as often as it is there; ValueError for another shape, or one too many: it is
    not made.

    A `config.json` from elsewhere may ask for a network of any size. Built first and compared with
    its weights afterwards, that costs gigabytes and minutes; held against the file variable by
    variable, a network that the file cannot fill ends at its first foreign variable.
    """
    import tensorflow as tf  # what lists the methods imports this, and waits for none

    left = collections.Counter(map(tuple, shapes))

    def make(next_creator, **options):
        value = options['initial_value']
        shape = tuple(tf.convert_to_tensor(value() if callable(value) else value).shape)
        if options.get('trainable') is not False:
            if not left[shape]:
                raise ValueError(
                    f'{source}: not the weights of config.json beside it, which asks for one more '
                    f'array of shape {shape} than there is'
                )
            left[shape] -= 1
        return next_creator(**options)

    with tf.variable_creator_scope(make):
        yield


def filled(path: str, make: Callable, named: Callable[[Any], dict] = weights_of):
    """What `make` makes, its variables, which `named` lists, with the values of weights.npz; none
    is made that the file does not hold.

    Raises:
      FileNotFoundError, ValueError: no weights there, weights that are not finite, or that have
        other names, shapes or kinds of numbers than the model's.
    """
    weights_path = os.path.join(path, WEIGHTS_FILE)
    if not os.path.isfile(weights_path):
        raise FileNotFoundError(
            f'{weights_path}: no such file; the training of {path} has not saved any weights yet'
        )
    stored = files.read_npz(weights_path)
    for name, value in stored.items():
        # Integers too: batch normalisations count their steps.
        if value.dtype.kind not in 'fi' or not np.isfinite(value).all():
            raise ValueError(f'{weights_path}: {name} is not finite ({value.dtype})')
    with only_shapes((value.shape for value in stored.values()), weights_path):
        model = make()
    variables = named(model)
    found = {n: (v.shape, v.dtype.kind) for n, v in stored.items()}
    wanted = {
        n: (tuple(v.shape), 'f' if v.dtype.is_floating else 'i') for n, v in variables.items()
    }
    if differing := sorted(n for n in found | wanted if found.get(n) != wanted.get(n)):
        raise ValueError(
            f'{weights_path}: not the weights of {CONFIG_FILE} beside it; differing: '
            f'{differing[:4]}'
        )
    for name, variable in variables.items():
        variable.assign(stored[name])
    return model


def folder_digest(path: str) -> str:
    """sha256 of what a model folder says a model is: config.json and its arrays."""
    names = sorted(n for n in os.listdir(path) if n == CONFIG_FILE or n.endswith('.npz'))
    parts = [f'{n} {files.sha256_of_file(os.path.join(path, n))}' for n in names]
    return hashlib.sha256('\n'.join(parts).encode()).hexdigest()


def refuse_contradictions(model_path: str, overrides: dict) -> None:
    """Raises ValueError if an override {field: value} is not what the settings, or the scene, of a
    model say."""
    values = read_config(model_path)
    with refusing_wrong_fields(model_path):
        known = {**values.get('scene', {}), **values['config']}
    for field, value in overrides.items():
        if field not in known:
            raise ValueError(f'{field}={value} is no setting of the model in {model_path}')
        if value != known[field]:
            raise ValueError(
                f'--{field}={value} contradicts the model in {model_path}, which has '
                f'{known[field]}: leave the flag out'
            )


def check_dataset(model_path, model, data_path, metadata):
    """Raises ValueError for a dataset of other modes, of another subspace, or as `check_parts`."""
    scene, config = model.simulator.scene, model.simulator.config
    found, first = metadata['mode_number'], getattr(config, 'modes', 0)
    if found < scene.n_modes or not first and found != scene.n_modes:
        raise ValueError(
            f'{data_path} has {found} modes, the model in {model_path} was trained on '
            f'{"the first " if first else ""}{scene.n_modes}'
        )
    there, here = read_config(model_path)['data'].get('subspace'), _subspace_digest(metadata)
    if None not in (there, here) and there != here:
        raise ValueError(
            f'{data_path} is in the subspace {here[:12]}..., the model in {model_path} was '
            f'trained on the modes of {there[:12]}...: convert the runs with --like, or train '
            f'again'
        )
    check_parts(model_path, scene, data_path, metadata)


def check_parts(model_path, scene, data_path, metadata):
    """Raises ValueError for a dataset with a force or context that only it or the scene of the
    model has."""
    keys = {'rigid_body_force_mean': scene.has_force, 'context_mean': bool(scene.context_names)}
    for key, wanted in keys.items():
        if (key in metadata) != wanted:
            has = 'has' if key in metadata else 'lacks'
            raise ValueError(
                f'{data_path}/metadata.json {has} {key}, unlike the data of {model_path}'
            )


def _subspace_digest(metadata):
    return metadata.get('pca', {}).get('digest')


def digests(folder: str, names: Iterable[str]) -> dict[str, str]:
    """Name -> sha256 of those files that a folder has."""
    paths = {name: os.path.join(folder, name) for name in names}
    return {n: files.sha256_of_file(path) for n, path in paths.items() if os.path.exists(path)}


def data_record(data_path: str, metadata: dict) -> dict:
    """Where training data came from, for `config.json`: the path as it was given, and digests."""
    return {
        'path': data_path,
        'sha256': digests(data_path, ('metadata.json', 'train.tfrecord')),
        'subspace': _subspace_digest(metadata),
    }


def holds_model(path: str, parts: dict[str, dict], own_files: Iterable[str] = ()) -> bool:
    """Whether a folder, which exists, holds a model already, which must then be one of these
    `parts`: entry of `config.json` -> what it says now, `path` aside; more may be in the file.
    `own_files` are further names that a killed training may leave before its `config.json`.
    ValueError for a folder of something else, or of another model; nothing was written."""
    if not os.path.exists(os.path.join(path, CONFIG_FILE)):
        ours = {*_FIRST, *own_files}
        strangers = {
            name for name in os.listdir(path)
            if name not in ours and not name.endswith('.tmp') and not name.startswith('events.')
        }  # fmt: skip
        if strangers:
            raise ValueError(
                f'{path}: not empty and not a model folder (holds {sorted(strangers)[:3]}); '
                f'nothing was written'
            )
        return False
    stored = read_config(path)
    for part, values in json.loads(json.dumps(parts)).items():
        old = stored.get(part)
        old = old if isinstance(old, dict) else {}
        differing = ', '.join(
            f'{k}: {old.get(k)!r} there, {values[k]!r} now'
            for k in sorted(values)
            if k != 'path' and old.get(k) != values[k]
        )
        if differing:
            raise ValueError(
                f'{path}: holds a model of another {part} ({differing}); nothing was written, give '
                f'another --model_path'
            )
    return True
