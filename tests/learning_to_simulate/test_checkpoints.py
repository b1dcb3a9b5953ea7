"""A model folder that asks for a larger network than its weights: refused before it is built."""

import json
import pathlib

import pytest
import tensorflow as tf

from learning_to_simulate import checkpoints
from learning_to_simulate.subspace import subspace_model
from nri import model as nri_model
from tests.learning_to_simulate import models
from tests.nri import small


@pytest.fixture
def made():
    """Shapes of all variables that are made."""
    shapes = []

    def creator(next_creator, **options):
        variable = next_creator(**options)
        shapes.append(tuple(variable.shape))
        return variable

    with tf.variable_creator_scope(creator):
        yield shapes


def change(folder, part, **values):
    path = folder / 'config.json'
    config = json.loads(path.read_text())
    (config[part] if part else config).update(values)
    path.write_text(json.dumps(config))


@pytest.fixture
def folder(tmp_path):
    return pathlib.Path(models.saved(tmp_path)[0])


@pytest.mark.parametrize(
    'forged',
    [
        {'latent_size': 4096}, {'hidden_layers': 32}, {'message_passing_steps': 100},
        {'model': 'mlp', 'adjacency': 'none'},
    ],
    ids=str,
)  # fmt: skip
def test_no_variable_is_made_that_the_weights_do_not_hold(folder, made, forged):
    whole = sum(v.shape.num_elements() for v in subspace_model.load(str(folder)).simulator
                .trainable_variables)  # fmt: skip
    made.clear()
    change(folder, 'config', **forged)
    with pytest.raises(ValueError, match='weights.npz: not the weights of config.json'):
        subspace_model.load(str(folder))
    assert sum(tf.TensorShape(shape).num_elements() for shape in made) <= whole


def test_loading_leaves_the_random_numbers_of_the_caller_alone(folder, monkeypatch):
    """Setting TensorFlow's seed also throws all its kernels away: half of the time of a load."""
    monkeypatch.setattr(tf.random, 'set_seed', lambda seed: pytest.fail(f'seed {seed} was set'))
    subspace_model.load(str(folder))


@pytest.mark.parametrize(
    ('part', 'forged', 'reason'),
    [
        ('config', {'hidden': 2**40}, 'hidden is'),
        ('config', {'hidden': 4096}, 'not the weights'),
        ('config', {'window': 5000}, 'not the weights'),
        ('config', {'hidden': 'x'}, 'hidden is'),
        ('config', {'symmetric': 'yes'}, 'symmetric is'),
        ('', {'node_names': ['n'] * 3000}, '3000 node names'),
        ('', {'scale': [[0.0] * 4]}, 'no finite normalisation'),
        ('', {'offset': 'x'}, 'could not convert'),
    ],
    ids=str,
)
def test_nri_models_are_held_to_their_weights(tmp_path, made, part, forged, reason):
    small.model(small.springs()).save(str(tmp_path))
    whole = sum(tf.TensorShape(shape).num_elements() for shape in made)
    made.clear()
    change(tmp_path, part, **forged)
    with pytest.raises(ValueError, match=reason):
        nri_model.load_model(str(tmp_path))
    assert sum(tf.TensorShape(shape).num_elements() for shape in made) <= whole


def test_each_shape_is_made_as_often_as_it_is_there():
    with checkpoints.only_shapes([(2,), (2,), (3, 1)], 'x.npz'):
        tf.Variable([1.0, 2.0])
        tf.Variable(tf.zeros([3, 1]))
        tf.Variable(lambda: tf.zeros([2]))
        with pytest.raises(ValueError, match=r'x.npz.*\(2,\)'):
            tf.Variable(tf.zeros([2]))
        tf.Variable(tf.zeros([9]), trainable=False)  # counters of a layer are not its weights
