"""Rows of the table of checks, kept in a file as they are made."""

import json
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

from mpm.files import write_json
from mpm.versions import SOLVER_VERSION
from pca_tools.storage import markdown


@dataclass(frozen=True)
class Check:
    """One row: a figure, what it should be, and within what.

    Attributes:
        name: what is compared.
        figure: measured.
        expected: its exact or published value; None for a figure that is only reported.
        tolerance: largest absolute difference.
        note: source, or what the figure is made of.
    """

    name: str
    figure: float
    expected: float | None
    tolerance: float
    note: str

    @property
    def passed(self) -> bool:
        """Whether the figure is within the tolerance; a reported one always is."""
        return self.expected is None or bool(abs(self.figure - self.expected) <= self.tolerance)


def reported(name: str, figure: float, note: str) -> Check:
    """Returns a row without a bound."""
    return Check(name, figure, None, 0.0, note)


def read_kept(path: str) -> dict:
    """Returns what a report keeps in a JSON file; without a file nothing but the version.

    Raises:
        ValueError: the file is no JSON, or of another version of the solver.
    """
    if not os.path.exists(path):
        return {'solver_version': SOLVER_VERSION}
    with open(path, encoding='utf-8') as file:
        content = json.load(file)
    if not isinstance(content, dict) or content.get('solver_version') != SOLVER_VERSION:
        raise ValueError(f'{path} is not of solver version {SOLVER_VERSION}; name another file')
    return content


class Table:
    """Checks by the name of what made them, written to a file after each.

    Attributes:
        entries: name -> {'checks': rows, 'cpu_s': seconds}.
    """

    def __init__(self, path: str):
        """Opens a table, or begins one.

        Raises:
            ValueError: if the file is none, or of another version of the solver.
        """
        self._path, self.entries = path, {}
        if not os.path.exists(path):
            return
        try:
            with open(path, encoding='utf-8') as file:
                content = json.load(file)
            version, self.entries = content['solver_version'], content['entries']
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f'{path} is not a table of checks: {error!r}') from error
        if version != SOLVER_VERSION:
            raise ValueError(
                f'{path} is of solver version {version}, this is {SOLVER_VERSION}; name another'
            )

    def add(self, name: str, make: Callable[[], list[Check]]) -> None:
        """Makes the checks of a name and writes them; those that are there are kept."""
        if name in self.entries:
            return
        started = time.process_time()
        checks = make()
        self.entries[name] = {
            'checks': [asdict(check) | {'passed': check.passed} for check in checks],
            'cpu_s': round(time.process_time() - started, 1),
        }
        write_json(self._path, {'solver_version': SOLVER_VERSION, 'entries': self.entries})

    @property
    def failed(self) -> list[str]:
        """Names of the checks that do not pass."""
        rows = [row for entry in self.entries.values() for row in entry['checks']]
        return [row['name'] for row in rows if not row['passed']]

    def text(self) -> str:
        """Returns the table as Markdown."""
        rows = []
        for entry in self.entries.values():
            for n, row in enumerate(entry['checks']):
                bound = ('', '', 'reported')
                if row['expected'] is not None:
                    result = 'pass' if row['passed'] else '**FAIL**'
                    bound = (f'{row["expected"]:.4g}', f'{row["tolerance"]:.2g}', result)
                name = f'{row["name"]} ({row["note"]})' if row['note'] else row['name']
                cpu = f'{entry["cpu_s"]:.0f}' if n == 0 else ''
                rows.append((name, f'{row["figure"]:.4g}', *bound, cpu))
        return markdown.table(('check', 'figure', 'expected', 'within', '', 'CPU s'), rows)


def table(path: str) -> str:
    """A stored table as Markdown, without notes and times; raises ValueError as `Table` does."""
    rows = []
    for entry in Table(path).entries.values():
        for row in entry['checks']:
            bound = '' if row['expected'] is None else f'{row["expected"]:.4g}'
            within = '' if row['expected'] is None else f'{row["tolerance"]:.2g}'
            passed = '' if row['passed'] else '**fails**'
            rows.append((row['name'], f'{row["figure"]:.4g}', bound, within, passed))
    return markdown.table(('check', 'figure', 'expected', 'within', ''), rows)
