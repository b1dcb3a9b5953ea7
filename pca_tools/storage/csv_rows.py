"""The one reader of CSV files of numbers with a header line."""

import csv
import math
from collections.abc import Callable, Collection, Iterator


def rows(
    path: str, numbers_of: Callable[[list[str]], list[str]], may_be_empty: Collection[str] = ()
) -> Iterator[tuple[int, dict[str, str], dict[str, float]]]:
    """Yields the line, the texts and the numbers of every row that is not empty, by column.

    `numbers_of` gives for a header the columns that hold numbers, and raises what it lacks; empty
    cells of the columns `may_be_empty` are NaN. FileNotFoundError: there is no such file.
    ValueError, with file and line: no CSV text, a column that comes twice, a row of another length,
    or a cell that is no finite number."""
    with open(path, encoding='utf-8-sig', newline='') as file:
        try:
            lines = csv.reader(file)
            header = [name.strip() for name in next(lines, [])]
            names = numbers_of(header)
            if len(set(header)) < len(header):
                raise ValueError(f'{path}, line 1: a column stands there twice: {header}')
            for cells in lines:
                if not any(cell.strip() for cell in cells):
                    continue
                where = f'{path}, line {lines.line_num}'
                if len(cells) != len(header):
                    raise ValueError(f'{where}: has {len(cells)} cells, the header {len(header)}')
                texts = dict(zip(header, (cell.strip() for cell in cells)))
                numbers = {
                    name: _number(texts[name], f'{where}: {name}', name in may_be_empty)
                    for name in names
                }
                yield lines.line_num, texts, numbers
        except (UnicodeDecodeError, csv.Error) as error:
            raise ValueError(f'{path}: is no CSV text: {error}') from error


def _number(text: str, where: str, may_be_empty: bool) -> float:
    if may_be_empty and not text:
        return math.nan
    try:
        value = float(text)
    except ValueError:
        what = 'is missing' if not text else f'is {text!r}, no number'
        raise ValueError(f'{where} {what}') from None
    if not math.isfinite(value):
        hint = '; leave it empty where nothing was measured' * may_be_empty
        raise ValueError(f'{where} is {text}{hint}')
    return value
