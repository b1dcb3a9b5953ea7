"""Where rollouts and networks are stable, where they refuse, and where they fail.

Experiments, not assertions (those are in tests/stiff): a line per case with outcome, figure and
threshold, as Markdown and JSON, with pictures.

Examples:
    python -m reports stability --quick --output_path=/tmp/stability   # 1 model, minutes

    # the whole report
    python -m reports stability --output_path=/tmp/stability

    python -m reports stability --parts=driven,network --output_path=/tmp/stability
"""

import functools
import importlib
import os
import time

import tqdm
from absl import flags

from pca_tools import files
from reports import command, record
from reports.stability import cases, pictures

# Part -> module and its function.
PARTS = {
    'rollouts': ('subspace_cases', 'run_rollouts'),
    'driven': ('driven_cases', 'run_driven'),
    'network': ('subspace_cases', 'run_network'),
}
REPORT, DATA = 'stability.md', 'stability.json'


def report(parts: list[str], is_quick: bool, output_path: str) -> list[cases.Case]:
    """Runs the parts and writes table, JSON and pictures; returns the rows.

    Args:
        parts: keys of `PARTS`.
        is_quick: one model, short runs.
        output_path: folder.

    Raises:
        ValueError: an unknown part.
    """
    if unknown := set(parts) - PARTS.keys():
        raise ValueError(f'unknown parts {sorted(unknown)}; there are {", ".join(PARTS)}')
    os.makedirs(output_path, exist_ok=True)
    rows: list[cases.Case] = []
    curves: dict = {}
    seconds: dict[str, float] = {}
    for part in parts:
        module, name = PARTS[part]
        run = getattr(importlib.import_module(f'reports.stability.{module}'), name)
        started = time.process_time()
        bar = functools.partial(tqdm.tqdm, desc=part, disable=None, leave=False)
        new, drawn = run(is_quick, bar)
        rows += new
        curves |= drawn
        seconds[part] = round(time.process_time() - started, 1)
        write(rows, curves, seconds, is_quick, output_path)
    return rows


def write(rows, curves: dict, seconds: dict, is_quick: bool, output_path: str) -> None:
    """Writes JSON, pictures and Markdown of the parts that are done.

    Args:
        rows: of all parts so far.
        curves: by name, for the pictures.
        seconds: CPU time of each part.
        is_quick: named in the text.
        output_path: folder.
    """
    values = {'cpu_seconds': seconds, 'rows': rows, 'curves': curves}
    document = record.provenance() | cases.to_json(values)
    # From what the JSON holds: a number that is rounded twice may end elsewhere.
    shown = [cases.Case(**row) for row in document['rows']]
    files.write_json(os.path.join(output_path, DATA), document)
    names = pictures.draw_all(curves, output_path)
    command = 'python -m reports stability' + (' --quick' if is_quick else '')
    text = [
        '# Stability report',
        '',
        f'Written by `{command} --output_path=...`; do not edit. Figures and curves: `{DATA}`.',
        '',
        summary(shown),
        '',
        cases.markdown(shown),
        *(f'![{name[:-4].replace("_", " ")}]({name})' for name in names),
        '',
    ]
    files.write_text(os.path.join(output_path, REPORT), '\n'.join(text))


def summary(rows: list[cases.Case]) -> str:
    """How many rows of each outcome, as a sentence."""
    outcomes = [row.outcome for row in rows]
    counts = (f'{outcomes.count(outcome)} {outcome}' for outcome in dict.fromkeys(outcomes))
    return f'{len(rows)} cases: ' + ', '.join(counts) + '.'


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_bool('quick', False, 'One model, short runs.')
    flags.DEFINE_string('output_path', None, 'Folder of the report.', required=True)
    flags.DEFINE_list('parts', list(PARTS), 'Which parts to run.')
    flags.DEFINE_integer('num_threads', 1, 'CPU threads of TensorFlow.', 1)


def main(values, _) -> int:
    """Runs the command; exit code 1 if a case fails that was promised to hold."""
    rows = report(values.parts, values.quick, values.output_path)
    print(cases.markdown(rows))
    print(summary(rows))
    print(f'wrote {os.path.join(values.output_path, REPORT)}')
    return int(any(row.outcome == cases.FAILS for row in rows))


if __name__ == '__main__':
    command.start(define_flags, main)
