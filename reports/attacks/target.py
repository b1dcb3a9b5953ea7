"""What is known of a reader that is fuzzed."""

import dataclasses
import enum
from collections.abc import Callable
from typing import Any


class Promise(enum.Enum):
    """What a reader owes its caller when the file was changed.

    SEALED: digests cover the files; a value that is returned equals the original one.
    CHECKSUM: so for damaged bytes, which a checksum finds; where the content was forged together
      with its checksum, a value that is returned is a possible one.
    OPEN: there is no checksum; a value that is returned is a possible one.
    """

    SEALED = 'sealed'
    CHECKSUM = 'checksum'
    OPEN = 'open'


@dataclasses.dataclass(frozen=True)
class Target:
    """A reader under test.

    Attributes:
      name: for the table.
      promise: see `Promise`.
      write: makes the valid files in a folder.
      changed: names of the files that are damaged, in turn.
      read: reads the folder.
      possible: whether a value could be that of some valid file, judged apart from the reader.
      parts: splits a value into parts; of a CHECKSUM file without a list of its parts, damage may
        lose or repeat whole ones.
      share: turns in each round of inputs; fewer for a reader that costs many times the others.
    """

    name: str
    promise: Promise
    write: Callable[[str], None]
    changed: tuple[str, ...]
    read: Callable[[str], Any]
    possible: Callable[[Any], bool] = lambda value: True
    parts: Callable[[Any], list] = lambda value: [value]
    share: int = 16
