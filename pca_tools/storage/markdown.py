"""The one writer of tables: Markdown, with columns in line for a terminal if asked."""

from collections.abc import Iterable, Sequence


def cell(value, digits: int = 3) -> str:
    """A value as text: None is empty, a float has `digits` digits, large ones no exponent."""
    if value is None:
        return ''
    if not isinstance(value, float):
        return str(value)
    whole = 10 ** (digits - 1) <= abs(value) < 1e9
    return f'{value:.0f}' if whole else f'{value:.{digits}g}'


def table(header: Sequence[str], rows: Iterable[Sequence], aligned: bool = False) -> str:
    """A table as Markdown, without a newline at its end, of values as `cell` takes them; a row may
    lack cells at its end, more are a ValueError. `aligned`: columns are filled up, to be read in a
    terminal."""
    lines = [list(header)]
    for row in rows:
        if len(row) > len(header):
            raise ValueError(f'{len(row)} cells under {len(header)} titles: {row}')
        lines.append([cell(value) for value in row] + [''] * (len(header) - len(row)))
    lines = [[text.replace('|', '\\|') for text in line] for line in lines]
    widths = [max(map(len, column)) if aligned else 0 for column in zip(*lines, strict=True)]
    rule = '|' + '|'.join('-' * max(width + 2, 3) for width in widths) + '|'
    first, *others = (
        '| ' + ' | '.join(text.ljust(width) for text, width in zip(line, widths)) + ' |'
        for line in lines
    )
    return '\n'.join([first, rule, *others])
