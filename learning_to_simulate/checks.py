"""Checks that programs make before they begin to work."""

import os
import tempfile


def writable_folder(path: str) -> None:
    """Makes a folder for results, where there is none, and writes an empty file to try.

    Args:
      path: folder; the file is gone afterwards.

    Raises:
      OSError: nothing can be written there.
    """
    try:
        os.makedirs(path, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise OSError(f'{path}: cannot be written to ({error.strerror})') from error
