"""Checks of the solver with numbers, as a table.

Examples:
    python -m mpm.verify --list_rows
    python -m mpm.verify --raw_path=raw --json=verify.json
    python -m mpm.verify --rows=free_fall,momentum

Each row is written to JSON when it is made; the same command goes on with those that are absent.
Runs that a row needs are read from RAW_PATH/excavation and RAW_PATH/wheel; those that are not
there are simulated into it (about two minutes each). All rows take 1.3 hours of one core.
The exit code is 1 if a check fails.
"""

import os

from absl import flags

from mpm.verification import rows


def jobs(raw_path: str) -> rows.Jobs:
    from mpm.verification import kernel_rows, run_rows  # help does not wait for Numba

    checks = kernel_rows.rows_of(raw_path) | run_rows.rows_of(raw_path)
    return {('entries', name): make for name, make in checks.items()}


def show(path: str) -> str:
    """Returns the kept checks as text, and which fail."""
    content = rows.read_kept(path)
    checks = rows.checks_of(content)
    failed = [f'{row["name"]}, {row["figure"]:.4g}' for row in checks if not row['passed']]
    seconds = sum(entry['cpu_s'] for entry in content.get('entries', {}).values())
    count = f'{len(checks) - len(failed)} of {len(checks)} checks pass; {seconds:.0f} s of CPU'
    parts = [rows.summary(path), count] + ['failed: ' + '; '.join(failed)] * bool(failed)
    return '\n\n'.join(parts)


if __name__ == '__main__':
    flags.DEFINE_string(
        'raw_path', os.path.join('outputs', 'verify'), 'Folder with the raw runs of both scenes.'
    )
    rows.run_report('verify', lambda values: jobs(values.raw_path), show)
