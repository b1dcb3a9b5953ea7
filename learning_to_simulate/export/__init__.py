"""Models for elsewhere: SavedModel, LiteRT, ONNX; `python -m learning_to_simulate.export`."""
