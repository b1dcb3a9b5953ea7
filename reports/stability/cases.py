"""What every part of the stability report hands back: rows of a table and curves for pictures."""

import dataclasses
import math

from reports.markdown import cell, table

# A curve of the JSON file holds no more points than a picture can show.
MAX_POINTS = 160
HOLDS, FAILS, MEASURED, REFUSED, FLAGGED = 'holds', 'FAILS', 'measured', 'refused', 'flagged'


@dataclasses.dataclass(frozen=True)
class Case:
    """One line of the report.

    Attributes:
      part: which part of the project.
      name: what was tried.
      figure: what was measured; None where the case was refused.
      unit: of the figure, in words.
      threshold: largest figure that counts as stable; None where nothing is promised.
      outcome: `holds`, `FAILS`, `measured`, `refused` (an error before anything ran on) or
        `flagged` (the rollout's own status says that it cannot be trusted).
      note: what else is worth knowing.
    """

    part: str
    name: str
    figure: float | None
    unit: str
    threshold: float | None
    outcome: str
    note: str = ''


def judged(part: str, name: str, figure: float, unit: str, threshold=None, note: str = '') -> Case:
    """A case whose outcome follows from figure and threshold; NaN never holds."""
    if threshold is None:
        return Case(part, name, figure, unit, None, MEASURED, note)
    outcome = HOLDS if figure <= threshold else FAILS
    return Case(part, name, figure, unit, threshold, outcome, note)


def markdown(rows: list[Case]) -> str:
    """The rows as Markdown, one table per part."""
    parts = []
    for part in dict.fromkeys(row.part for row in rows):
        cells = [
            (
                row.name,
                f'**{row.outcome}**' if row.outcome == FAILS else row.outcome,
                '' if row.figure is None else f'{cell(row.figure)} {row.unit}',
                row.threshold,
                row.note,
            )
            for row in rows
            if row.part == part
        ]
        header = ('case', 'outcome', 'figure', 'threshold', '')
        parts.append(f'### {part}\n\n{table(header, cells)}\n')
    return '\n'.join(parts)


def to_json(value):
    """`value` for JSON: arrays as short lists, four digits, None for numbers that JSON lacks.

    Series of more than `MAX_POINTS` are thinned; all of a curve have one length, so they still fit.
    """
    if dataclasses.is_dataclass(value):
        return to_json(dataclasses.asdict(value))
    if isinstance(value, dict):
        return {str(key): to_json(item) for key, item in value.items()}
    if hasattr(value, 'tolist'):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        stride = math.ceil(len(value) / MAX_POINTS)
        is_series = stride > 1 and isinstance(value[0], (int, float, type(None)))
        return [to_json(item) for item in (value[::stride] if is_series else value)]
    if isinstance(value, float):
        return float(f'{value:.4g}') if math.isfinite(value) else None
    return value
