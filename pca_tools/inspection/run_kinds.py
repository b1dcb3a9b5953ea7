"""What the runs of a dataset are like, by kind and split: counts, motion kept, leaks, spectrum.

The kind of a run is `kind` in its parameters (`grid`, `smooth`, ...); runs that state none are one
kind of their own.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pca_tools.dataset import Trajectory
from pca_tools.inspection.findings import Inspection
from pca_tools.statistics import mean_share

UNSTATED = 'not stated'
# Edges of the bands of the force spectrum, Hz; the last one ends at half the frame rate.
BANDS = (0.0, 1.0, 3.0, 6.0, 12.0)
_PENETRATION = 'penetration_'


def kinds_of(inspection: Inspection) -> dict[str, list[tuple[str, int]]]:
    """Returns kind -> (split, record) of all readable runs; one kind where no cases are listed."""
    kinds: dict[str, list[tuple[str, int]]] = {}
    for split, part in inspection.splits.items():
        for index in range(len(part)):
            kind = _parameters(inspection, split, index).get('kind', UNSTATED)
            kinds.setdefault(str(kind), []).append((split, index))
    return dict(sorted(kinds.items()))


def _parameters(inspection: Inspection, split: str, index: int) -> dict[str, Any]:
    cases = inspection.metadata.get('cases', {}).get(split, [])
    return cases[index] if index < len(cases) and isinstance(cases[index], dict) else {}


def kind_table(inspection: Inspection) -> list[str]:
    """Runs and motion energy kept by kind and split."""
    kinds = kinds_of(inspection)
    if not kinds:
        return []
    lines = ['', '  runs (motion energy kept)' + ''.join(f'{s:>20}' for s in inspection.splits)]
    for kind, places in kinds.items():
        cells = ''
        for split in inspection.splits:
            indices = [index for name, index in places if name == split]
            cells += f'{_count_and_share(inspection, split, indices):>20}'
        lines.append(f'    {kind:<23}{cells}')
    return lines


def _count_and_share(inspection: Inspection, split: str, indices: list[int]) -> str:
    kept = inspection.metadata.get('motion_kept', {}).get(split, [])
    moved = inspection.metadata.get('motion_mse', {}).get(split, [])
    if not indices or max(indices) >= min(len(kept), len(moved)):
        return str(len(indices) or '-')
    share = mean_share([kept[i] for i in indices], [moved[i] for i in indices])
    return f'{len(indices)} ({100 * share:.2f} %)'


def floor_table(inspection: Inspection) -> list[str]:
    """RMS in mm that so many modes leave, by split."""
    floors = inspection.metadata.get('projection_floors')
    if not isinstance(floors, dict) or not isinstance(floors.get('modes'), list):
        return []
    lines = ['', '  RMS that modes leave [mm]' + ''.join(f'{m:>10}' for m in floors['modes'])]
    for split, values in floors.items():
        if split != 'modes':
            cells = ''.join(f'{1e3 * value**0.5:>10.3f}' for value in values)
            lines.append(f'    {split:<23}{cells}')
    return lines


def leak_table(inspection: Inspection) -> list[str]:
    """Smallest, mean and largest of every `penetration_...` parameter, by kind."""
    lines = []
    for kind, places in kinds_of(inspection).items():
        found: dict[str, list[tuple[float, str]]] = {}
        for split, index in places:
            parameters = _parameters(inspection, split, index)
            for name, value in parameters.items():
                if name.startswith(_PENETRATION) and _is_number(value):
                    found.setdefault(name, []).append((value, f'case {parameters.get("case")}'))
        for name, values in sorted(found.items()):
            numbers = [value for value, _ in values]
            lines.append(
                f'    {kind:<23}{name:<34}{min(numbers):>10.3g}{np.mean(numbers):>10.3g}'
                f'{max(numbers):>10.3g} ({max(values)[1]})'
            )
    head = f'  {"soil in the body":<25}{"":<34}{"least":>10}{"mean":>10}{"most":>10}'
    return ['', head, *lines] if lines else []


def force_table(inspection: Inspection) -> list[str]:
    """Share of the force's variance in each band of frequencies, by kind."""
    dt = inspection.metadata['dt']
    bands = [f'{low:g}-{high:.3g}' for low, high in zip(BANDS, (*BANDS[1:], 0.5 / dt))]
    lines = []
    for kind, places in kinds_of(inspection).items():
        runs = [inspection.splits[split][index] for split, index in places]
        runs = [run for run in runs if run.force is not None and run.n_frames > 2]
        if not runs:
            continue
        shares, peak = force_spectrum(runs, dt)
        size = math.sqrt(np.mean([np.mean(np.sum(run.force**2, axis=-1)) for run in runs]))
        jump = max(float(np.abs(np.diff(run.force, axis=0)).max()) for run in runs)
        lines.append(
            f'    {kind:<23}{size:>9.4g}{jump:>12.4g}'
            + ''.join(f'{100 * share:>9.2f}' for share in shares)
            + f'{peak:>11.2f}'
        )
    head = (
        f'  {"force spectrum":<25}{"RMS [N]":>9}{"jump [N]":>12}'
        + ''.join(f'{band:>9}' for band in bands)
        + f'{"peak [Hz]":>11}'
    )
    note = '  (variance in bands of Hz, %; jump: largest change in a frame; peak: above 1 Hz)'
    return ['', head, *lines, note] if lines else []


def force_spectrum(runs: list[Trajectory], dt: float) -> tuple[np.ndarray, float]:
    """Measures how fast the force changes.

    Args:
        runs: some runs with force.
        dt: seconds per frame.

    Returns:
        shares of the variance about each run's mean in the bands of `BANDS` (sum 1, or 0 where the
        force is constant), and the frequency in Hz of the strongest line above 1 Hz.
    """
    shares, lines = np.zeros(len(BANDS)), {}
    for run in runs:
        change = run.force.astype(np.float64) - run.force.mean(axis=0, dtype=np.float64)
        power = np.sum(np.abs(np.fft.rfft(change, axis=0)) ** 2, axis=-1)
        # All lines but the first and, for an even number of frames, the last stand for two.
        power[1 : (len(change) + 1) // 2] *= 2.0
        power /= len(change)
        frequency = np.fft.rfftfreq(len(change), dt)
        band = np.searchsorted(BANDS, frequency, side='right') - 1
        shares += np.bincount(band, power, minlength=len(BANDS))
        for where, strength in zip(frequency, power):
            if where > BANDS[1]:
                lines[round(where, 6)] = lines.get(round(where, 6), 0.0) + strength
    total = shares.sum()
    peak = max(lines, key=lines.get) if lines else 0.0
    return (shares / total if total > 0 else shares), peak


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
