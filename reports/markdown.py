"""Words and numbers of the reports' tables, beside the writer that all packages share."""

from collections.abc import Iterable

from pca_tools.storage.markdown import cell, table

__all__ = ['TRIVIAL', 'cell', 'span', 'table']

# How tables and pictures name the predictors that know nothing, by their keys in metrics.json.
TRIVIAL = {'stay_still': 'persistence', 'constant_velocity': 'constant velocity'}


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
