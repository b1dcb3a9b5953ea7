"""Checks and results of the solver, each made once and kept in a JSON file; their command."""

import json
import os
import re
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from absl import flags
from tqdm import tqdm

from mpm import SOLVER_VERSION
from pca_tools import command
from pca_tools.files import read_json, write_text
from pca_tools.storage import markdown

# Place of a result in the file, as names from the outside in -> function that makes it (checks or
# a dictionary).
Jobs = dict[tuple[str, ...], Callable[[], Any]]


@dataclass(frozen=True)
class Check:
    """A figure, what it should be (None: it is only reported), and within what.

    The note says the source, or what the figure is made of.
    """

    name: str
    figure: float
    expected: float | None = None
    tolerance: float = 0.0
    note: str = ''

    @property
    def passed(self) -> bool:
        return self.expected is None or bool(abs(self.figure - self.expected) <= self.tolerance)


def checks_of(content: dict) -> list[dict]:
    return [row for entry in content.get('entries', {}).values() for row in entry['checks']]


def summary(path: str, only: str = '') -> str:
    """Returns the kept checks of a JSON file as Markdown, those that check the same of other cases
    in one row; `only` names entries by their beginnings, with commas, of which those that are
    judged are shown. ValueError: as `read_kept`."""
    groups: dict[tuple, list[dict]] = {}
    for name, entry in read_kept(path).get('entries', {}).items():
        for row in entry['checks'] if name.startswith(tuple(only.split(','))) else ():
            subject, _, what = row['name'].partition(':')
            # 'excavation 186', 'column collapse, a = 0.5' and 'wheel 122' without their numbers.
            subject = re.sub(r'(, a =)? [0-9.]+$', '', subject)
            if row['expected'] is not None or not only:
                key = subject, what, row['expected'], row['tolerance']
                groups.setdefault(key, []).append(row)
    rows = []
    for (subject, what, expected, tolerance), members in groups.items():
        low, high = (f'{f(row["figure"] for row in members):.3g}' for f in (min, max))
        limit = '' if expected is None else f'{expected:.4g} +- {tolerance:.2g}'
        failed = sum(not row['passed'] for row in members)
        found = low if low == high else f'{low} to {high}'
        rows.append(
            (f'{subject}:{what}', len(members), found, limit, f'**{failed} fail**' * bool(failed))
        )
    return markdown.table(('check', 'rows', 'figure', 'limit', ''), rows)


def read_kept(path: str) -> dict:
    """Returns what a report keeps in a JSON file, nothing but the version without one; ValueError:
    no JSON, or of another version of the solver."""
    if not os.path.exists(path):
        return {'solver_version': SOLVER_VERSION}
    content = read_json(path)
    if not isinstance(content, dict) or content.get('solver_version') != SOLVER_VERSION:
        raise ValueError(f'{path} is not of solver version {SOLVER_VERSION}; name another file')
    return content


def make(path: str, jobs: Jobs, names: list[str] | None = None) -> dict:
    """Makes the results that a JSON file does not hold yet, those in whose names one of `names`
    stands (None: all), and writes it after each. Returns what the file then holds.

    ValueError: a name that no result has; see `read_kept`.
    """
    content = read_kept(path)
    for text in names or ():
        if not any(text in name_of(place) for place in jobs):
            raise ValueError(f'no row {text!r}; there are {", ".join(map(name_of, jobs))}')
    os.makedirs(os.path.dirname(path) or '.', exist_ok=True)
    chosen = [p for p in jobs if names is None or any(text in name_of(p) for text in names)]
    for place in tqdm(chosen, unit='row'):
        inner = content
        for name in place[:-1]:
            inner = inner.setdefault(name, {})
        if place[-1] not in inner:
            started = time.process_time()
            found = jobs[place]()
            if not isinstance(found, dict):
                found = {'checks': [asdict(one) | {'passed': one.passed} for one in found]}
            inner[place[-1]] = {'cpu_s': round(time.process_time() - started, 1)} | found
            write_text(path, _lines(content) + '\n')
    return content


def name_of(place: tuple[str, ...]) -> str:
    return '/'.join(place[1:])


def _lines(content) -> str:
    """JSON with a line for each result: a number a line would make 50 thousand."""
    if not isinstance(content, dict) or not any(isinstance(v, dict) for v in content.values()):
        return json.dumps(content, allow_nan=False)
    inner = ',\n'.join(f'{json.dumps(name)}: {_lines(value)}' for name, value in content.items())
    return f'{{\n{inner}\n}}'


def run_report(
    name: str,
    jobs: Callable[[flags.FlagValues], Jobs],
    show: Callable[[str], str],
    draw: Callable[[str, str], None] | None = None,
) -> None:
    """Runs a report as the main program: makes the `jobs` (of the values of the flags), keeps them
    in a file called `name` where no other is given, prints what `show` says of that file, and lets
    `draw` draw a picture from it."""
    flags.DEFINE_string('json', os.path.join('outputs', f'{name}.json'), 'Where results are kept.')
    flags.DEFINE_list('rows', None, 'Only results in whose names one of these stands.')
    flags.DEFINE_bool('list_rows', False, 'Only name the results.')
    if draw is not None:
        flags.DEFINE_string('picture', None, 'Picture to draw.')

    def run(values):
        asked = jobs(values)
        if values.list_rows:
            print('\n'.join(map(name_of, asked)))
            return 0
        content = make(values.json, asked, values.rows)
        print(show(values.json))
        if draw is not None and values.picture:
            draw(values.json, values.picture)
        return int(not all(row['passed'] for row in checks_of(content)))

    command.start(run)
