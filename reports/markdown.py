"""The one writer of tables: Markdown, with columns in line for a terminal if asked."""

from collections.abc import Iterable, Sequence

# How tables and pictures name the predictors that know nothing, by their keys in metrics.json, and
# what the modes cannot hold of the particles.
TRIVIAL = {'stay_still': 'persistence', 'constant_velocity': 'constant velocity'}
FLOOR = 'truncation error'


def cell(value, digits: int = 3) -> str:
    """A value as text: None is empty, a float has `digits` digits, large ones no exponent."""
    if value is None:
        return ''
    if not isinstance(value, float):
        return str(value)
    whole = 10 ** (digits - 1) <= abs(value) < 1e9
    return f'{value:.0f}' if whole else f'{value:.{digits}g}'


def span(values: Iterable[float | None], digits: int = 3) -> str:
    """'mean (smallest to largest)' of the values there are; one number where all are equal."""
    known = [float(v) for v in values if v is not None]
    if not known:
        return ''
    low, high = min(known), max(known)
    if low == high:
        return cell(low, digits)
    mean = sum(known) / len(known)
    return f'{cell(mean, digits)} ({cell(low, digits)} to {cell(high, digits)})'


def table(header: Sequence[str], rows: Iterable[Sequence], aligned: bool = False) -> str:
    """A table as Markdown, without a newline at its end.

    Args:
      header: titles of the columns.
      rows: values as `cell` takes them; a row may lack cells at its end.
      aligned: whether columns are filled up, to be read in a terminal.

    Raises:
      ValueError: a row has more cells than the header.
    """
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
