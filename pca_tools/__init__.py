"""Subspace (PCA), rigid fit, and the datasets of the project: reading, writing, checking,
conversion.

Nothing is imported here, so that `pca_tools.subspace`, `pca_tools.rigid_fit` and `pca_tools.files`
stay free of TensorFlow, which only `pca_tools.tfrecord_io` touches, and only when a record is read
or written.
"""
