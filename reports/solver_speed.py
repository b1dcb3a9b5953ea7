"""CPU seconds of the solver as it is and of another checkout of it, run in turns.

Nothing else should run beside it. Packing and compilation are not counted.

Example:
    git worktree add /tmp/version_1 19d34cb
    python -m reports solver_speed --other=/tmp/version_1 --json=docs/solver/speed.json
"""

import os
import subprocess
import sys
import tempfile

from absl import flags

from mpm import raw_run
from pca_tools import files
from reports import command, markdown, record


def cpu_seconds(checkout: str, scene: str, case: str, folder: str) -> float:
    """Simulates one run with the solver of a checkout; returns the CPU seconds it states.

    Args:
        checkout: folder that holds `mpm`.
        scene: name of a scene.
        case: number or id of the run.
        folder: for the raw run, new for each checkout.

    Raises:
        ValueError: no solver there, or it fails; with its last words.
    """
    if not os.path.exists(os.path.join(checkout, 'mpm', 'generate.py')):
        raise ValueError(f'{checkout}: holds no solver (mpm/generate.py)')
    done = subprocess.run(
        [sys.executable, '-m', 'mpm.generate', f'--scene={scene}', f'--cases={case}',
         f'--output_path={os.path.abspath(folder)}'],
        cwd=checkout, capture_output=True, text=True,
        env={**os.environ, 'PYTHONPATH': checkout},
    )  # fmt: skip
    if done.returncode:
        raise ValueError(
            f'{checkout}: the solver ends with {done.returncode}: {done.stderr[-500:]}'
        )
    (entry,) = (raw_run.read_manifest(folder) or {})['runs']
    return float(entry['parameters']['solver_cpu_s'])


def measure(other: str, cases: list[str], repeats: int) -> list[dict]:
    """Returns for each `scene:case` the seconds of both, `repeats` times in turns.

    Raises:
        ValueError: see `cpu_seconds`; a case that is not `scene:case`.
    """
    pairs = [case.split(':') for case in cases]
    if wrong := [case for case, pair in zip(cases, pairs) if len(pair) != 2]:
        raise ValueError(f'cases {wrong}: scene:case was expected, such as excavation:186')
    rows = []
    for scene, case in pairs:
        row: dict = {'scene': scene, 'case': case, 'other': [], 'this': []}
        for _ in range(repeats):
            for name, checkout in (('other', other), ('this', record.ROOT)):
                with tempfile.TemporaryDirectory() as folder:
                    row[name].append(cpu_seconds(checkout, scene, case, folder))
                print(f'{scene} {case}, {name}: {row[name][-1]:.1f} s', flush=True)
        rows.append(row)
    return rows


def table(path: str) -> str:
    """The table of a JSON of this report, least seconds of the repeats."""
    rows = [
        (f'{row["scene"]} {row["case"]}', min(row['other']), min(row['this']),
         min(row['this']) / min(row['other']))
        for row in files.read_json(path)['rows']
    ]  # fmt: skip
    return markdown.table(['run', 'the other, CPU s', 'this, CPU s', 'this / other'], rows)


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('other', None, 'Checkout of another version.', required=True)
    flags.DEFINE_list('cases', ['excavation:186', 'wheel:122'], 'Runs, scene:case.')
    flags.DEFINE_integer('repeats', 1, 'How often each is run.', 1)
    flags.DEFINE_string('json', None, 'Where the figures go.', required=True)


def main(values, _) -> None:
    """Runs the command."""
    rows = measure(os.path.abspath(values.other), values.cases, values.repeats)
    files.write_json(values.json, record.provenance() | {'rows': rows})
    print(table(values.json))


if __name__ == '__main__':
    command.start(define_flags, main)
