"""Feeds damaged and forged files to everything that reads files, and counts what happens.

A reader may refuse (ValueError or OSError with the name of the file in its message) or return a
value: the original one, or, where the files carry no checksum, one that some valid file could hold.
Everything else is a failure: another exception, a crash of the process, more than 10 s, more than
1 GB of memory, a damaged file that passes. Inputs are functions of (seed, number); those that fail
are kept in `<output_path>/fuzz_failures/`.

Examples:
    python -m reports fuzz --count=1000000 --seed=0 --num_processes=8 --output_path=docs

    python -m reports fuzz --count=2000 --targets=subspace.npz --output_path=/tmp/fuzz
"""

import concurrent.futures
import functools
import multiprocessing
import os
import tempfile

import tqdm
from absl import flags

from pca_tools import files
from pca_tools.storage import parent
from reports import command, markdown, record

COLUMNS = {
    'refused': 'refused',
    'equal': 'read as the original',
    'possible': 'read as another valid file',
    'failed': 'failures',
}
_PART = 5000  # inputs of a process


def alone(function, *arguments):
    """Calls a function in a fresh process.

    Raises:
      concurrent.futures.process.BrokenProcessPool: the process died.
    """
    context = multiprocessing.get_context('spawn')
    with concurrent.futures.ProcessPoolExecutor(1, context, parent.end_with_parent) as pool:
        return pool.submit(function, *arguments).result()


def run_part(names: list[str], seed: int, part: tuple[int, int]) -> dict:
    """Runs inputs `part` in processes of their own; one that dies is a failure of its input.

    Args:
      names: of the targets.
      seed: of the inputs.
      part: first number, and one beyond the last.

    Returns:
      `first`, `last`; `counts`: target -> outcome -> number; `failures`: list of target, number and
      reason.
    """
    from reports.attacks import bench

    counts = {name: dict.fromkeys(COLUMNS, 0) for name in names}
    failures = []
    with tempfile.TemporaryDirectory() as folder:
        note, todo = os.path.join(folder, 'note'), [part]
        while todo:
            first, last = todo.pop()
            try:
                found = alone(bench.run_alone, names, seed, first, last, note)
            except concurrent.futures.process.BrokenProcessPool as error:
                if not os.path.exists(note):
                    raise OSError('a fuzzing process ended before any input') from error
                with open(note, encoding='utf-8') as file:
                    number = int(file.read())
                os.remove(note)
                # What was counted before it in this process is lost: it is run again.
                todo += [p for p in ((first, number), (number + 1, last)) if p[0] < p[1]]
                name = bench.dealt(names, number).name
                failure = {'target': name, 'number': number, 'why': 'the process died'}
                found = {'counts': {name: {'failed': 1}}, 'failures': [failure]}
            _add(counts, found['counts'])
            failures += found['failures']
    return {'first': part[0], 'last': part[1], 'counts': counts, 'failures': failures}


def _add(counts, more):
    for name, outcomes in more.items():
        for outcome, count in outcomes.items():
            counts[name][outcome] += count


def save_failures(path: str, failures: list[dict], names: list[str], seed: int) -> None:
    """Writes the inputs that failed, with the reason beside each."""
    from reports.attacks import bench

    for failure in failures:
        folder = os.path.join(path, f'{failure["number"]:07d}')
        name, data = bench.make_input(names, seed, failure['number'])
        os.makedirs(folder, exist_ok=True)
        with open(os.path.join(folder, name), 'wb') as file:
            file.write(data)
        files.write_text(os.path.join(folder, 'why.txt'), f'{failure["target"]}\n{failure["why"]}')


def table(parts: list[dict]) -> str:
    """The outcomes by target, as Markdown; `parts` of `run_part`."""
    from reports.attacks.targets import TARGETS

    counts = {name: dict.fromkeys(COLUMNS, 0) for name in parts[0]['counts']}
    for part in parts:
        _add(counts, part['counts'])
    promises = {target.name: target.promise.value for target in TARGETS}
    rows = [[name, promises[name], sum(o.values()), *o.values()] for name, o in counts.items()]
    sums = [sum(column) for column in zip(*(row[2:] for row in rows))]
    header = ('reader', 'promise', 'inputs', *COLUMNS.values())
    return markdown.table(header, [*rows, ['**all**', '', *sums]])


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_integer('count', 10_000, 'Inputs in all, dealt to the readers in turn.', 1)
    flags.DEFINE_integer('seed', 0, 'Seed of the inputs.')
    flags.DEFINE_integer('num_processes', 1, 'Processes.', 1)
    flags.DEFINE_list('targets', None, 'Names of readers as in the table; default: all.')
    flags.DEFINE_string('output_path', None, 'Folder for fuzz.json and failing inputs.')


def main(values, _) -> int:
    """Runs the command; exit code 1 if an input failed."""
    from reports.attacks.targets import TARGETS

    known = [target.name for target in TARGETS]
    names = [name for name in known if values.targets is None or name in values.targets]
    if unknown := set(values.targets or ()) - set(known):
        raise ValueError(f'no readers named {sorted(unknown)}; there are {known}')
    path, parts, head = values.output_path, [], record.provenance()
    if path:
        os.makedirs(path, exist_ok=True)
    run = functools.partial(run_part, names, values.seed)
    starts = range(0, values.count, _PART)
    pieces = [(start, min(start + _PART, values.count)) for start in starts]
    with concurrent.futures.ThreadPoolExecutor(values.num_processes) as threads:
        done = threads.map(run, pieces)
        for part in tqdm.tqdm(done, total=len(pieces), unit='part', disable=None):
            parts.append(part)
            if path:
                document = head | {'seed': values.seed, 'readers': names, 'parts': parts}
                files.write_json(f'{path}/fuzz.json', document)
                save_failures(f'{path}/fuzz_failures', part['failures'], names, values.seed)
    print(table(parts))
    failures = [failure for part in parts for failure in part['failures']]
    for failure in failures[:20]:
        last_line = failure['why'].strip().splitlines()[-1]
        print(f'input {failure["number"]} of {failure["target"]}: {last_line}')
    return int(bool(failures))


if __name__ == '__main__':
    command.start(define_flags, main)
