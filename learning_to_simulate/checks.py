"""Checks that programs make before they begin to work."""

import os
import tempfile


def writable_folder(path: str) -> None:
    """Tries whether results can be written into a folder, and leaves nothing behind.

    Args:
      path: folder; it need not exist.

    Raises:
      OSError: nothing can be written there.
    """
    missing, above = [], os.path.abspath(path)
    while not os.path.exists(above):
        missing.append(above)
        above = os.path.dirname(above)
    try:
        os.makedirs(path, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
        for folder in missing:
            os.rmdir(folder)
    except OSError as error:
        raise OSError(f'{path}: cannot be written to ({error.strerror})') from error
