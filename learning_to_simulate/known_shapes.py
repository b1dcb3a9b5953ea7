"""Variables are made only in the shapes that a weights file holds.

A `config.json` from elsewhere may ask for a network of any size. Built first and compared with its
weights afterwards, that costs gigabytes and minutes; held against the file variable by variable, a
network that the file cannot fill ends at its first foreign variable.
"""

import collections
import contextlib
from collections.abc import Iterable, Iterator


@contextlib.contextmanager
def only(shapes: Iterable[tuple[int, ...]], source: str) -> Iterator[None]:
    """Lets a `with` block make trainable variables of the shapes of all arrays of a file
    (`source`), each as often as it is there; ValueError for another shape, or one too many: it is
    not made."""
    import tensorflow as tf  # what lists the methods imports this, and waits for none

    left = collections.Counter(map(tuple, shapes))

    def make(next_creator, **options):
        value = options['initial_value']
        shape = tuple(tf.convert_to_tensor(value() if callable(value) else value).shape)
        if options.get('trainable') is not False:
            if not left[shape]:
                raise ValueError(
                    f'{source}: not the weights of config.json beside it, which asks for one more '
                    f'array of shape {shape} than there is'
                )
            left[shape] -= 1
        return next_creator(**options)

    with tf.variable_creator_scope(make):
        yield
