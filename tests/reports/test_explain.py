"""What the rollout leaves out, counted and listed."""

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate import rollout
from reports import explain, explanation
from tests.learning_to_simulate import models


def test_products_count_what_depends_on_the_arguments():
    w = tf.Variable(tf.ones([4, 5]))

    def function(x):
        both = tf.matmul(w, tf.ones([5, 6]))  # weights only: once, not per frame
        y = tf.einsum('ab,bc->ac', x, both)
        return tf.matmul(tf.reshape(y, [1, 3, 6]), tf.ones([1, 3, 2]), transpose_a=True)

    got = explanation.mflop(function, tf.ones([3, 4]))
    np.testing.assert_allclose(got * 1e6, 2 * (3 * 4 * 6) + 2 * (6 * 3 * 2))


def made_and_counted(folder, **settings):
    """A small model, and the MFLOP of its plain frame."""
    model, (group, *_), _ = models.make(folder, **settings)
    layout = model.layout(group.n_rigid)
    inputs = rollout.rollout_inputs(group.select(0), layout, model.simulator.scene)
    return model, explanation.plain_frame(model.simulator, layout, *inputs[:3])


def test_plain_frame_equals_the_count_by_the_layers(tmp_path):
    """Four rigid particles and three modes, L = 16, two hidden layers, one step."""
    model, got = made_and_counted(tmp_path)
    v, e, width = 7, 4 * 3 + 5, 16
    features = model.simulator.network.weights().node_encoder.layers[0][0].shape[0]
    node = features + 2 * width + 2 * width  # encoder; ends of the edges
    node += 4 * width + (2 * width + 6)  # update, decoder
    edge = 4 + 2 * width + 3 * width  # encoder; messages, first layer of the edge alone
    expected = 2 * width * (v * node + e * edge) + 2 * v * e * width  # and their sums
    np.testing.assert_allclose(got * 1e6, expected)


def test_a_frame_costs_the_same_where_its_context_changes(tmp_path):
    constant, changing = (
        made_and_counted(tmp_path / str(context), context=context)[1]
        for context in (True, 'changing')
    )
    assert constant == changing > 0


@pytest.fixture(scope='module')
def trained(tmp_path_factory):
    few = {'rigid_particles': 2, 'modes': 2, 'mode_edges': 3}
    return models.saved(tmp_path_factory.mktemp('explain'), rigid_counts=(6,), overrides=few)


def _three_frames(*arguments):
    state, known, context, _ = rollout.rollout_inputs(*arguments)
    return state, type(known)(*(x[:3] for x in known[:2])), context, 3


def test_every_item_is_listed_with_what_it_saves(trained, monkeypatch):
    monkeypatch.setattr(explanation, 'rollout_inputs', _three_frames)
    with models.eagerly():
        values = explanation.Explanation(*trained).measure(rounds=1)
    items = {item['name'].split(' (')[0]: item for item in values['items']}
    edges = 2 * 2 + 3
    assert (values['nodes'], values['edges']) == (4, edges)
    assert items['edges that the graph does not have']['edges'] == 16 - edges
    assert items['rigid particles that are no nodes']['edges'] == 4 * 2
    assert items['modes that are no nodes']['weights'] == 16  # a row of the embedding
    assert items['modes that are no nodes']['mflop'] > 0
    assert '. edges that reach no output, of all steps' not in items
    assert items['context: rows of the first layer']['us_per_step'] is None
    text = explain.table(values)
    assert all(item['name'] in text for item in values['items']) and 'nan' not in text
