"""Tables in documents that are made from JSON, and stay so.

A document marks a table by two comments:

    <!-- protocol: excavation.json test soil_mm -->
    ...
    <!-- end -->

`update` writes between them what the JSON says, `differences` finds what does not agree: a number
in a document has a file.
"""

import os
import re

from pca_tools import files
from reports.protocol import tables

_BLOCK = re.compile(r'(<!-- protocol: ([^\n]*?) -->\n)(.*?)(<!-- end -->)', re.DOTALL)
REPORT, HORIZONS, RUNS = 'report', 'horizons', 'runs'


def rendered(folder: str, specification: str) -> str:
    """The text that a mark asks for.

    Args:
      folder: of the document; JSON files are named relative to it.
      specification: `FILE SPLIT report`, `... horizons`, `... runs QUANTITY` or
        `... QUANTITY [KIND]`.

    Raises:
      FileNotFoundError, ValueError: no such file, or a mark that asks for nothing known.
    """
    words = specification.split()
    if len(words) < 3:
        raise ValueError(f'mark {specification!r}: FILE SPLIT TABLE was expected')
    name, split, table, *rest = words
    path = os.path.join(folder, name)
    document = files.read_json(path)
    try:
        if table == REPORT:
            return tables.scene_report(document, split)
        if table == HORIZONS:
            return tables.horizon_table(document, split)
        if table == RUNS:
            return tables.run_table(document, split, rest[0])
        return tables.quantity_table(document, split, table, *rest)
    except (KeyError, IndexError, TypeError) as error:
        raise ValueError(f'mark {specification!r}: {path} holds no such table ({error})') from error


def update(path: str) -> int:
    """Writes the tables of a document anew; returns how many there are."""
    with open(path, encoding='utf-8') as file:
        text = file.read()
    folder = os.path.dirname(path)
    text, count = _BLOCK.subn(lambda m: f'{m[1]}{rendered(folder, m[2])}\n{m[4]}', text)
    files.write_text(path, text)
    return count


def differences(path: str) -> list[str]:
    """Marks of a document whose table is not what the JSON says."""
    with open(path, encoding='utf-8') as file:
        text = file.read()
    folder = os.path.dirname(path)
    return [
        mark for _, mark, table, _ in _BLOCK.findall(text)
        if table.rstrip('\n') != rendered(folder, mark)
    ]  # fmt: skip
