"""MFLOP of one frame, counted in the traced graph: its matrix products, two per multiply and add.

Products of weights with weights do not count: they are done once, not per frame. Neither does work
element by element, which is small beside the products.
"""

import numpy as np
import tensorflow as tf

_TRANSPOSED = {'MatMul': 'transpose_a', 'BatchMatMulV2': 'adj_x'}


def mflop(function, *arguments) -> float:
    """MFLOP of the products in `function(*arguments)` that depend on its arguments."""
    graph = tf.function(function, autograph=False).get_concrete_function(*arguments).graph
    captured = {tensor.name for tensor in graph.internal_captures}
    moving = {tensor.name for tensor in graph.inputs} - captured
    total = 0
    for operation in graph.get_operations():
        if any(tensor.name in moving for tensor in operation.inputs):
            moving |= {tensor.name for tensor in operation.outputs}
            total += _flop(operation)
    return total / 1e6


def _flop(operation):
    if operation.type == 'Einsum':
        labels = operation.get_attr('equation').decode().split('->')[0].split(',')
        sizes = {}
        for names, tensor in zip(labels, operation.inputs, strict=True):
            sizes |= dict(zip(names, tensor.shape.as_list(), strict=True))
        return 2 * int(np.prod(list(sizes.values())))
    if operation.type not in _TRANSPOSED:
        return 0
    transposed = operation.get_attr(_TRANSPOSED[operation.type])
    inner = operation.inputs[0].shape[-2 if transposed else -1]
    return 2 * inner * operation.outputs[0].shape.num_elements()


def plain_frame(simulator, layout, state, known, context) -> float:
    """MFLOP of a frame of `LearnedSimulator.step`; `state` ... of `rollout.rollout_inputs`."""
    coming = None if known is None else known.at(0)
    return mflop(lambda *x: simulator.step(*x, layout), state, coming, context)
