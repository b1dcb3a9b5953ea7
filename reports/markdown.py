"""Words and numbers of the reports' tables, beside the writer that all packages share."""

from collections.abc import Iterable

from pca_tools.storage.markdown import cell, table

__all__ = ['cell', 'mean', 'span', 'table']


def mean(values: Iterable[float | None]) -> str:
    """The mean of the values there are; nothing without any."""
    known = [float(v) for v in values if v is not None]
    return cell(sum(known) / len(known)) if known else ''


def span(values: Iterable[float | None]) -> str:
    """'mean (smallest to largest)' of the values there are; one number where all are equal."""
    known = [float(v) for v in values if v is not None]
    if len(set(known)) < 2:
        return cell(known[0]) if known else ''
    return f'{mean(known)} ({cell(min(known))} to {cell(max(known))})'
