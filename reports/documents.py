"""Writes the tables of the documents from the JSON that they name, so that no number drifts.

A table that follows a comment of this form is what the function makes of the files:

    <!-- table: reports.protocol.tables:shipped docs/protocol/wheel.json -->

Arguments are paths below the root of the project, or words; the table ends at an empty line. A
table with measured numbers and no such comment says why: `<!-- no record: ... -->` before it.
`tests/test_documents.py` holds all documents to this.

Examples:
    python -m reports documents            # writes the tables that changed
    python -m reports documents README.md  # of one document
"""

import importlib
import os
import re
import subprocess
from collections import Counter

from pca_tools import dataset, files
from pca_tools.metadata import SPLITS
from reports import markdown
from reports.record import ROOT

MOST_ARGUMENTS = 1000  # names of documents
NAMED = re.compile(r'<!-- table: ([\w.]+):(\w+)((?: [^\s>]+)*) -->\n((?:.+\n)*)')


def render(text: str) -> str:
    """A document with its named tables made anew; ValueError: a comment names no function, or one
    that makes no table of its arguments."""

    def made(match):
        module, name, arguments, _ = match.groups()
        paths = [p if os.path.exists(p := os.path.join(ROOT, a)) else a for a in arguments.split()]
        try:
            table = getattr(importlib.import_module(module), name)(*paths)
        except (ImportError, AttributeError, TypeError, KeyError, OSError) as error:
            raise ValueError(f'{match[0].splitlines()[0]}: {error!r}') from error
        return f'<!-- table: {module}:{name}{arguments} -->\n{table.strip()}\n'

    return NAMED.sub(made, text)


def names() -> list[str]:
    """The Markdown files of the project, relative to its root."""
    done = subprocess.run(
        ['git', '-C', ROOT, 'ls-files', '--cached', '--others', '--exclude-standard', '*.md'],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.splitlines()


def runs(*paths: str) -> str:
    """Of each dataset its runs by split, and their kinds."""
    rows = []
    for path in paths:
        cases = dataset.read_metadata(path)['cases']
        kinds = Counter(run['kind'] for of in cases.values() for run in of)
        rows.append([
            f'`{os.path.basename(path)}`', *(len(cases.get(split, [])) for split in SPLITS),
            ', '.join(f'{kind} {count}' for kind, count in sorted(kinds.items())),
        ])  # fmt: skip
    return markdown.table(['dataset', *SPLITS, 'of each kind'], rows)


def define_flags() -> None:
    """It has none."""


def main(_, arguments) -> None:
    for name in arguments or names():
        path = os.path.join(ROOT, name)
        with open(path, encoding='utf-8') as file:
            old = file.read()
        new = render(old)
        if new != old:
            files.write_text(path, new)
            print(f'wrote {name}')
