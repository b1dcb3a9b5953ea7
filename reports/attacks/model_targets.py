"""Readers of model folders that are fuzzed: the parts, both kinds of model whole, the FMU's text.

The whole ones build what a forged `config.json` asks for, so they show what it costs: tens of
milliseconds an input, hence their small share.
"""

import dataclasses
from xml.etree import ElementTree

import numpy as np
import tensorflow as tf

from learning_to_simulate import checkpoints
from learning_to_simulate.config import TrainConfig
from learning_to_simulate.export_c import fmu_description, model_data
from learning_to_simulate.normalization import Statistics
from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.subspace import subspace_model
from learning_to_simulate.subspace.learned_simulator import LearnedSimulator
from nri import model as nri_model
from nri.config import NriConfig
from pca_tools import files
from reports.attacks.target import Promise, Target

R, MODES = 2, 2
WEIGHT_SHAPES = {'000.layer/w': (3, 4), '001.layer/b': (4,)}
_SCENE = Scene(
    'fuzz', MODES, RigidMotion.DRIVEN, ((0, 1), (1, 0)), True, ('gravity',), 6, 0.0166
)  # fmt: skip
_MASK = np.array([[1, 0], [1, 1]], bool)


def _statistics() -> Statistics:
    """Of a model of our style with a driven body, all parts present."""
    classes = MODES + 1
    pair, axes = (classes, classes, 3), (3,)
    shapes = {
        'displacement_mean': pair, 'displacement_std': pair, 'force_mean': axes, 'force_std': axes,
        'position_range': (2, classes, 3), 'given_range': (2, 3), 'body_extent_range': (2, 3),
        'given_velocity_range': (2, 3),
        'body_speed_range': (2, 1), 'context_range': (2, 1),
    }  # fmt: skip
    ones = ('height', 'body_speed', 'context', 'log')
    arrays = {}
    for field in dataclasses.fields(Statistics):
        default = (1,) if field.name.startswith(ones) else (classes, 3)
        arrays[field.name] = np.full(shapes.get(field.name, default), 0.25)
    # Neither an input nor a share of a driven body's; and no C form has a torque.
    arrays |= dict.fromkeys(('path', 'contact', 'surface', 'torque_mean', 'torque_std'))
    return Statistics(**arrays)


def _write_model(folder: str) -> None:
    config = TrainConfig('pcg', latent_size=4, hidden_layers=1)
    simulator = LearnedSimulator(_SCENE, config, _statistics())
    model = subspace_model.Model(simulator, _MASK, None)
    tf.random.set_seed(0)
    model.create_variables(R)
    checkpoints.save_config(folder, model, R, {'path': 'x', 'sha256': {}})
    checkpoints.save_weights(folder, simulator)


def _read_model(folder: str):
    model = subspace_model.load(folder)
    simulator = model.simulator
    weights = [variable.numpy() for variable in simulator.trainable_variables]
    return simulator.config, simulator.scene, model.edge_counts(), weights


def _possible_model(value) -> bool:
    config, scene, _, weights = value
    widths = {width for weight in weights for width in weight.shape}
    return (
        all(np.isfinite(weight).all() for weight in weights)
        and config.latent_size in widths
        and scene.n_modes == MODES
    )


def _write_nri(folder: str) -> None:
    config = NriConfig(hidden=4, window=6, segment=2)
    offset = np.zeros((1, 4))
    nri_model.NriModel(config, ('a', 'b', 'c'), offset, offset + 1.0, 'digest').save(folder)


def _read_nri(folder: str):
    model = nri_model.load_model(folder)
    # What a window of zeros says about the edges: the numbers of the file are used, too.
    shape = (1, len(model.node_names), model.config.window, model.offset.shape[1])
    frames = np.zeros(shape, np.float32)
    return model.config, model.node_names, model.encode(frames, is_training=False).numpy()


def _possible_nri(value) -> bool:
    config, names, logits = value
    return logits.shape == (1, len(names) * (len(names) - 1), config.edge_types)


def _read_config(folder: str):
    return subspace_model.parse(checkpoints.read_config(folder), f'{folder}/config.json')


def _possible_mask(mask) -> bool:
    return mask.dtype == bool and mask.ndim == 2 and mask.shape[0] == mask.shape[1]


def _possible_config(parts) -> bool:
    masks = [m for m in (parts.mode_mask, parts.loaded_mask) if m is not None]
    arrays = [a for a in dataclasses.asdict(parts.statistics).values() if a is not None]
    small = parts.config.latent_size <= 4096 and parts.n_rigid <= 1000
    return small and all(np.isfinite(a).all() for a in arrays) and all(map(_possible_mask, masks))


def _write_weights(folder: str) -> None:
    rng = np.random.default_rng(0)
    arrays = {name: rng.random(shape, np.float32) for name, shape in WEIGHT_SHAPES.items()}
    files.write_npz(f'{folder}/{checkpoints.WEIGHTS_FILE}', **arrays)


def _possible_weights(weights) -> bool:
    return {n: w.shape for n, w in weights.items()} == WEIGHT_SHAPES and all(
        np.isfinite(w).all() for w in weights.values()
    )


def _describe(folder: str):
    """The FMU's description of a model folder, with its names as an importing tool reads them."""
    parts = _read_config(folder)
    rest = np.zeros((R, 3))
    start = {'modes': rest, 'points': rest, 'context': np.ones(len(parts.scene.context_names))}
    try:
        text = fmu_description.fmi2('soil', _values(parts.scene, start), ['lts.c'])
    except ValueError as error:  # the description is made of values: it knows no file
        raise ValueError(f'{folder}/config.json: {error}') from error
    return parts.scene, text


def _values(scene: Scene, start: dict) -> dict:
    """The part of `model_data.values` that a description needs; weights are not."""
    return {
        'name': scene.name,
        'context_names': ','.join(scene.context_names),
        'n_context': len(scene.context_names),
        'motion': model_data.motion_of(scene),
        'dt': scene.dt,
        'digest': '0' * 64,
        'n_start': 1,
        'starts': [start],
    }


def _possible_description(value) -> bool:
    """It parses, says what the scene says, and no two variables have one name."""
    scene, text = value
    root = ElementTree.fromstring(text)
    names = [v.get('name') for v in root.iter('ScalarVariable')]
    step = root.find('DefaultExperiment').get('stepSize')
    return (
        len(set(names)) == len(names)
        and set(scene.context_names) <= set(names)
        and float(step) == scene.dt
        and root.get('description').endswith(scene.name)
    )


MODEL_TARGETS = (
    Target('model config.json', Promise.OPEN, _write_model, ('config.json',), _read_config,
           _possible_config),
    Target('model weights.npz', Promise.CHECKSUM, _write_weights, ('weights.npz',),
           lambda folder: checkpoints.read_weights(folder, WEIGHT_SHAPES), _possible_weights),
    Target('load_model', Promise.OPEN, _write_model, ('config.json', 'weights.npz'), _read_model,
           _possible_model, share=1),
    Target('load_model of NRI', Promise.OPEN, _write_nri, ('config.json', 'weights.npz'),
           _read_nri, _possible_nri, share=1),
    Target('FMU description', Promise.OPEN, _write_model, ('config.json',), _describe,
           _possible_description),
)  # fmt: skip
