"""The file formats that functions with fixed shapes are written in, and read again from.

Each writer takes the concrete functions by name, the variables that they hold and a folder, and
returns a function that loads what it wrote: name -> a function of named arrays that gives a dict.
A SavedModel has a signature for each function, LiteRT and ONNX have a file for each.
"""

import functools
import os

import tensorflow as tf
from tensorflow.python.framework import convert_to_constants

from pca_tools import files


def concrete(functions: dict, kind: str) -> dict:
    """Name -> concrete function of functions with `tf.TensorSpec` of their inputs by name; those of
    a SavedModel are compiled by XLA."""
    compiled = kind == 'savedmodel' or None
    return {
        name: tf.function(function, autograph=False, jit_compile=compiled).get_concrete_function(
            **inputs
        )
        for name, (function, inputs) in functions.items()
    }


def _write_saved_model(functions, variables, folder: str):
    holder = tf.Module(name='exported')  # Nothing but the weights goes into the file as an object.
    holder.weights = variables
    tf.saved_model.save(holder, folder, signatures=functions)

    def load():
        loaded = tf.saved_model.load(folder)

        def call(name, **inputs):
            return loaded.signatures[name](**{k: tf.constant(v) for k, v in inputs.items()})

        return {name: functools.partial(call, name) for name in functions}

    return load


def _write_tflite(functions, variables, folder: str):
    try:
        from ai_edge_litert.interpreter import Interpreter
    except ImportError as error:
        raise ValueError(_missing('ai-edge-litert')) from error
    holder = tf.Module(name='exported')
    holder.weights = variables
    paths = {name: os.path.join(folder, f'{name}.tflite') for name in functions}
    for name, concrete in functions.items():
        converter = tf.lite.TFLiteConverter.from_concrete_functions([concrete], holder)
        _write_bytes(paths[name], converter.convert())

    def load():
        return {
            name: Interpreter(model_path=path).get_signature_runner()
            for name, path in paths.items()
        }

    return load


def _write_onnx(functions, variables, folder: str):
    try:
        import onnxruntime
        import tf2onnx
    except ImportError as error:
        raise ValueError(_missing(error.name)) from error
    paths = {name: os.path.join(folder, f'{name}.onnx') for name in functions}
    for name, concrete in functions.items():
        # tf2onnx loses the inputs of a function of today's TensorFlow, but not of a frozen graph.
        frozen = convert_to_constants.convert_variables_to_constants_v2(concrete)
        ends = [[tensor.name for tensor in part] for part in (frozen.inputs, frozen.outputs)]
        proto, _ = tf2onnx.convert.from_graph_def(
            frozen.graph.as_graph_def(), input_names=ends[0], output_names=ends[1], opset=17
        )
        inputs = {end: end.split(':')[0] for end in ends[0]}
        _rename(proto.graph, inputs | dict(zip(ends[1], _outputs(concrete), strict=True)))
        _write_bytes(paths[name], proto.SerializeToString())

    def load():
        def caller(path, names):
            session = onnxruntime.InferenceSession(path, providers=['CPUExecutionProvider'])
            return lambda **inputs: dict(zip(names, session.run(names, inputs), strict=True))

        return {name: caller(paths[name], _outputs(c)) for name, c in functions.items()}

    return load


def _outputs(concrete):
    """Names of outputs in the order in which TensorFlow flattens a dict."""
    return sorted(concrete.structured_outputs)


def _rename(graph, names):
    for value in (*graph.input, *graph.output):
        value.name = names.get(value.name, value.name)
    for node in graph.node:
        for ends in (node.input, node.output):
            ends[:] = [names.get(name, name) for name in ends]


def _write_bytes(path, content):
    def write(name):
        with open(name, 'wb') as file:
            file.write(content)

    files.write_atomically(path, write)


def _missing(package):
    return f'{package} is not installed; it comes with the extra: pip install -e .[deploy]'


WRITERS = {'savedmodel': _write_saved_model, 'tflite': _write_tflite, 'onnx': _write_onnx}
