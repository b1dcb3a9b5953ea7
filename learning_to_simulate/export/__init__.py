"""Models for elsewhere: SavedModel, LiteRT, ONNX; `lts export`."""
