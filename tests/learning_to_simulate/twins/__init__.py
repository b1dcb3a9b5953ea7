"""Independent numpy twins of what TensorFlow computes."""
