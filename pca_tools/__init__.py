"""Datasets of the project: reading, writing, checking, conversion; the PCA is `subspace.py`.

Nothing is imported here, so that `pca_tools.subspace`, `pca_tools.rigid_fit` and `pca_tools.files`
stay free of TensorFlow, which only `pca_tools.tfrecord_io` touches, and only when a record is read
or written. `pca_tools.write_raw` is loaded when it is first asked for.
"""

__all__ = ['write_raw']


def __getattr__(name: str):
    if name == 'write_raw':
        from pca_tools.raw_runs import write_raw

        return write_raw
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
