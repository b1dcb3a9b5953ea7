"""Model folders: what a trained model is, on disk.

  config.json    the whole `TrainConfig`, scene, statistics, edges, data digest, package versions
  weights.npz    weights for evaluation (moving averages where the config has them): arrays only,
                 no code, no pickle
  start.npz, subspace.npz   what the model needs to run without its dataset (`resting_start`)
  ckpt-<step>.*  `tf.train.Checkpoint` of weights, optimiser and step, to resume training

A folder that ships with the project holds no checkpoints.
"""

import dataclasses
import hashlib
import importlib.metadata
import os
from collections.abc import Callable

import numpy as np
import tensorflow as tf

from learning_to_simulate import known_shapes, model_config, registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH
from learning_to_simulate.connectivity_utils import build
from learning_to_simulate.methods import path_memory
from learning_to_simulate.subspace.learned_simulator import Layout, LearnedSimulator, SimulatorState
from learning_to_simulate.subspace.rigid_body import KnownMotion
from pca_tools import files
from pca_tools.subspace import Subspace

CONFIG_FILE, WEIGHTS_FILE = 'config.json', 'weights.npz'
SCHEMA_VERSION = 1


@dataclasses.dataclass
class Model:
    """A simulator with what is needed to run it on graphs of any number of rigid particles.

    Attributes:
      simulator: the network with its scene, config and statistics.
      mode_mask: bool [r, r] of the mode -> mode edges, completed by Algorithm 2; else None.
      loaded_mask: bool [V, V] from an edge file, used as it is; else None.
      edge_source: where the edges come from; None if the model folder does not say.
    """

    simulator: LearnedSimulator
    mode_mask: np.ndarray | None
    loaded_mask: np.ndarray | None
    edge_source: str | None = None

    def __post_init__(self):
        self._layouts = {}

    def layout(self, n_rigid: int) -> Layout:
        """The graph for R rigid particles, built once.

        Raises:
          ValueError: if the model's edges do not fit graphs of that size.
        """
        if n_rigid not in self._layouts:
            s = self.simulator
            s.check_size(n_rigid)
            adjacency = build(
                s.config.adjacency, s.scene, n_rigid, self.mode_mask, self.loaded_mask
            )
            self._layouts[n_rigid] = Layout(adjacency, n_rigid, s.scene, s.statistics, s.config)
        return self._layouts[n_rigid]

    def edge_counts(self) -> dict[str, int]:
        """Number of edges of every graph that was built, by its R."""
        return {str(n): layout.n_edge for n, layout in self._layouts.items()}

    def fix_mode_edges(self, mode_mask: np.ndarray, source: str = 'learned gates') -> None:
        """Takes another list of mode -> mode edges; graphs are built anew.

        Args:
          mode_mask: bool [r, r], entry [receiver, sender].
          source: where it comes from.
        """
        self.mode_mask, self.edge_source = mode_mask, source
        sizes, self._layouts = list(self._layouts), {}
        for n_rigid in sizes:
            self.layout(n_rigid)

    def fitting_subspace(self, subspace: Subspace) -> Subspace:
        """The modes of a dataset's subspace that the model predicts: all, or the first ones.

        Raises:
          ValueError: the subspace has other modes or particles than the model's.
        """
        scene, first = self.simulator.scene, self.simulator.config.modes
        if first and subspace.n_modes > first:
            subspace = dataclasses.replace(subspace, components=subspace.components[:, :first])
        found, wanted = (subspace.n_modes, subspace.n_soil), (scene.n_modes, scene.n_soil)
        if found[0] != wanted[0] or wanted[1] not in (None, found[1]):
            raise ValueError(
                f'the subspace has {found[0]} modes of {found[1]} particles, the model was trained '
                f'on {wanted[0]} modes of {wanted[1]}'
            )
        return subspace

    def create_variables(self, n_rigid: int):
        """Makes all variables by running one frame of zeros; their values follow TensorFlow's
        seed, which whoever trains sets. Setting it throws all kernels away, so loading does not."""
        s, layout = self.simulator, self.layout(n_rigid)
        state = SimulatorState(
            tf.zeros([1, layout.n_node, s.dim]),
            tf.zeros([1, layout.n_node, INPUT_SEQUENCE_LENGTH - 1, s.dim]),
        )
        body = tf.zeros([1, n_rigid, s.dim])
        known = KnownMotion(body, body)
        if layout.memory is not None:
            start = tf.zeros([1, s.scene.n_modes, s.dim])
            known = KnownMotion(body, body, tf.zeros([1, path_memory.WIDTH]), start)
        s.predict(state, known, tf.zeros([1, len(s.scene.context_names)]), layout)


def save_config(path: str, model: Model, n_rigid: int, data: dict, files_beside=None) -> None:
    """Writes config.json.

    Args:
      path: model folder.
      model: the model.
      n_rigid: any R the model runs on; used to rebuild its variables.
      data: where the training data came from (path, digests), for the record.
      files_beside: name -> sha256 of what else the model needs (`resting_start`); None where it
        has nothing of that kind.
    """
    s = model.simulator
    files.write_json(
        os.path.join(path, CONFIG_FILE),
        {
            'schema_version': SCHEMA_VERSION,
            'config': dataclasses.asdict(s.config),
            'scene': s.scene.to_json(),
            'particle_types': list(s.particle_types),
            'n_rigid': n_rigid,
            'edge_source': model.edge_source,
            'edges': model.edge_counts(),
            'mode_mask': None if model.mode_mask is None else model.mode_mask.astype(int).tolist(),
            'loaded_mask': None
            if model.loaded_mask is None
            else model.loaded_mask.astype(int).tolist(),
            'statistics': s.statistics.to_json(),
            'data': data,
            'files': files_beside or {},
            'packages': {
                name: importlib.metadata.version(name)
                for name in ('numpy', 'dm-sonnet', 'graph_nets')
            }
            | {'tensorflow': tf.__version__},
        },
    )


def _weights(simulator):
    """Variables by a name that does not change between processes: their order of creation and shape
    role."""
    return {
        f'{i:03d}.{v.name.split(":")[0]}': v for i, v in enumerate(simulator.trainable_variables)
    }


def save_weights(path: str, simulator: LearnedSimulator) -> None:
    """Writes weights.npz whole or not at all.

    Args:
      path: model folder.
      simulator: the model.

    Raises:
      ValueError: if a weight is not finite; the file of before stays.
    """
    names = list(_weights(simulator))
    values = [v.numpy() for v in simulator.trainable_variables]
    bad = [n for n, v in zip(names, values, strict=True) if not np.isfinite(v).all()]
    if bad:
        raise ValueError(f'{path}: not saved, weights are not finite: {bad[:3]}')
    files.write_npz(os.path.join(path, WEIGHTS_FILE), **dict(zip(names, values, strict=True)))


def read_config(path: str) -> dict:
    """Reads and checks config.json.

    Raises:
      FileNotFoundError: if the folder holds no model.
      ValueError: if the file is of another kind or version.
    """
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


def load_model(path: str) -> Model:
    """Loads a model for evaluation from config.json and weights.npz.

    Raises:
      FileNotFoundError, ValueError: no model there, or weights that are not those of the config;
        no variable is made that the weights do not hold.
    """
    parts = model_config.parse(read_config(path), os.path.join(path, CONFIG_FILE))

    def make():
        simulator = registry.get(parts.config.model).make_simulator(
            parts.scene, parts.config, parts.statistics, parts.particle_types
        )
        model = Model(simulator, parts.mode_mask, parts.loaded_mask, parts.edge_source)
        model.create_variables(parts.n_rigid)
        return model

    return filled(path, make)


def filled(path: str, make: Callable):
    """A model with the weights of weights.npz.

    Args:
      path: model folder.
      make: makes the model with all variables of its `simulator`.

    Raises:
      as `read_weights`; no variable is made that the file does not hold.
    """
    stored = stored_weights(path)
    with known_shapes.only((w.shape for w in stored.values()), os.path.join(path, WEIGHTS_FILE)):
        model = make()
    variables = _weights(model.simulator)
    check_weights(path, stored, {n: tuple(v.shape) for n, v in variables.items()})
    for name, variable in variables.items():
        variable.assign(stored[name])
    return model


def read_weights(path: str, shapes: dict[str, tuple]) -> dict[str, np.ndarray]:
    """Reads weights.npz.

    Args:
      path: model folder.
      shapes: name -> shape of every weight that the model has.

    Raises:
      FileNotFoundError, ValueError: no weights there, other weights, or weights that are not
        finite.
    """
    stored = stored_weights(path)
    check_weights(path, stored, shapes)
    return stored


def stored_weights(path: str) -> dict[str, np.ndarray]:
    """The finite arrays of weights.npz, whatever they are of; raises as `read_weights`."""
    weights_path = os.path.join(path, WEIGHTS_FILE)
    if not os.path.isfile(weights_path):
        raise FileNotFoundError(
            f'{weights_path}: no such file; the training of {path} has not saved any weights yet'
        )
    stored = files.read_npz(weights_path)
    for name, value in stored.items():
        if value.dtype.kind != 'f' or not np.isfinite(value).all():
            raise ValueError(f'{weights_path}: {name} is not finite ({value.dtype})')
    return stored


def check_weights(path: str, stored: dict[str, np.ndarray], shapes: dict[str, tuple]) -> None:
    """Raises ValueError if arrays have other names or shapes."""
    weights_path = os.path.join(path, WEIGHTS_FILE)
    found = {n: v.shape for n, v in stored.items()}
    if shapes != found:
        differing = sorted(n for n in shapes.keys() | found.keys() if shapes.get(n) != found.get(n))
        raise ValueError(
            f'{weights_path}: not the weights of {CONFIG_FILE} beside it; differing: '
            f'{differing[:4]}'
        )


def folder_digest(path: str) -> str:
    """sha256 of what a model folder says a model is: config.json and its arrays."""
    names = sorted(n for n in os.listdir(path) if n == CONFIG_FILE or n.endswith('.npz'))
    parts = [f'{n} {files.sha256_of_file(os.path.join(path, n))}' for n in names]
    return hashlib.sha256('\n'.join(parts).encode()).hexdigest()


def refuse_contradictions(model_path, config, overrides):
    """Raises ValueError if an override {field: value} is not what the model's config, or scene,
    says."""
    for field, value in overrides.items():
        if value != getattr(config, field):
            raise ValueError(
                f'--{field}={value} contradicts the model in {model_path}, which has '
                f'{getattr(config, field)}: leave the flag out'
            )


def subspace_digest(metadata):
    """Which modes the records are scores of; None for folders that do not state it."""
    return metadata.get('pca', {}).get('digest')


def check_dataset(model_path, model, data_path, metadata):
    """Refuses a dataset that a model does not fit.

    Raises:
      ValueError: other modes, another subspace, a force or context that one of them lacks, or no
        torque where the model predicts one.
    """
    scene = model.simulator.scene
    found, first = metadata['mode_number'], model.simulator.config.modes
    if found < scene.n_modes or not first and found != scene.n_modes:
        raise ValueError(
            f'{data_path} has {found} modes, the model in {model_path} was trained on '
            f'{"the first " if first else ""}{scene.n_modes}'
        )
    digests = (
        read_config(model_path)['data'].get('subspace'),
        subspace_digest(metadata),
    )
    if None not in digests and digests[0] != digests[1]:
        raise ValueError(
            f'{data_path} is in the subspace {digests[1][:12]}..., the model in {model_path} was '
            f'trained on the modes of {digests[0][:12]}...: convert the runs with --like, or train '
            f'again'
        )
    keys = {
        'rigid_body_force_mean': scene.has_force,
        'context_mean': bool(scene.context_names),
    }
    # Settings of methods that are no networks in a subspace do not have it.
    if getattr(model.simulator.config, 'predict_torque', False):
        keys['rigid_body_torque_mean'] = True
    for key, wanted in keys.items():
        if (key in metadata) != wanted:
            has = 'has' if key in metadata else 'lacks'
            raise ValueError(
                f'{data_path}/metadata.json {has} {key}, unlike the data of {model_path}'
            )
