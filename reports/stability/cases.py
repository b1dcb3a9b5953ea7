"""What every part of the stability report hands back, and how paths go on: frame numbers."""

import dataclasses
import math

import numpy as np

from reports.markdown import cell, table

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
    outcome = MEASURED
    if threshold is not None:
        outcome = HOLDS if figure <= threshold else FAILS
    return Case(part, name, figure, unit, threshold, outcome, note)


def markdown(rows: list[Case]) -> str:
    """The rows as Markdown, one table per part."""
    parts: dict[str, list] = {}
    for row in rows:
        outcome = f'**{row.outcome}**' if row.outcome == FAILS else row.outcome
        figure = '' if row.figure is None else f'{cell(row.figure)} {row.unit}'
        parts.setdefault(row.part, []).append((row.name, outcome, figure, row.threshold, row.note))
    header = ('case', 'outcome', 'figure', 'threshold', '')
    return '\n'.join(f'### {part}\n\n{table(header, cells)}\n' for part, cells in parts.items())


def to_json(value):
    """`value` for JSON: arrays as lists, four digits, None for numbers that JSON lacks."""
    if dataclasses.is_dataclass(value):
        value = dataclasses.asdict(value)
    if isinstance(value, dict):
        return {str(key): to_json(item) for key, item in value.items()}
    value = getattr(value, 'tolist', lambda: value)()
    if isinstance(value, (list, tuple)):
        return [to_json(item) for item in value]
    if isinstance(value, float):
        return float(f'{value:.4g}') if math.isfinite(value) else None
    return value


def to_and_fro(n_frame: int, length: int):
    """Frame numbers 0 .. T-1 and back and so on, `length` of them."""
    return (n_frame - 1) - np.abs((n_frame - 1) - np.arange(length) % (2 * (n_frame - 1)))


def hold(n_frame: int, length: int):
    """Frame numbers 0 .. T-1, then the last one for ever."""
    return np.minimum(np.arange(length), n_frame - 1)
