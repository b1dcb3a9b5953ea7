"""Text and JSON files, whole or not at all."""

import json
from typing import Any

from pca_tools.storage import whole_files


def write_text(path: str, text: str) -> None:
    """Writes UTF-8 text, whole or not at all."""

    def write(temporary: str) -> None:
        with open(temporary, 'w', encoding='utf-8', newline='') as file:
            file.write(text)

    whole_files.write_file(path, write)


def write_json(path: str, content: Any, indent: int = 2) -> None:
    """Writes indented JSON, whole or not at all.

    Raises:
        ValueError: `content` holds NaN or infinity, which JSON does not have.
    """
    try:
        text = json.dumps(content, indent=indent, allow_nan=False)
    except ValueError as error:
        raise ValueError(f'{path}: cannot be written as JSON: {error}') from error
    write_text(path, text + '\n')
