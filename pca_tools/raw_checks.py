"""What may be wrong with raw runs: the manifest, the arrays of a run, units, the upward axis.

Every check returns sentences, so that a person is told all of them at once.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from pca_tools.dataset import FRAME_SERIES, has_shape
from pca_tools.matching import median_spacing
from pca_tools.metadata import AXES, DIM, bounds_problems, is_number, scene_problems, short

# Arrays with a first axis of frames -> shape of a frame; None: as many as the scene has.
SERIES = {'positions': (None, DIM), 'rigid_positions': (None, DIM)} | {
    name.removeprefix('rigid_'): shape for name, shape in FRAME_SERIES.items()
}
SCENE_KEYS = ('name', 'rigid_motion', 'rigid_edges', 'context_names', 'force')
ENTRY_KEYS = {'file', 'case', 'bytes', 'sha256'}
# More faults than this are counted, not listed.
MAX_LISTED = 30
# Soil on a table or under a machine: grains closer than 10 um or farther than 1 m, beds of more
# than 500 m, or anything at 20 m/s are mistaken units before they are soil.
SPACING = (1e-5, 1.0)
EXTENT = (1e-3, 500.0)
SPEED = 20.0
# Of the extent of the bounds: how far inside the free space above the bed must exceed that below,
# and that of every other axis, before an axis is taken for the upward one.
_ASYMMETRY = 0.2


def faults_error(where: str, faults: Iterable[str]) -> ValueError:
    """Returns one error that lists all faults of a file or folder."""
    faults = list(faults)
    if len(faults) == 1:
        return ValueError(f'{where}: {faults[0]}')
    listed = ''.join(f'\n  - {fault}' for fault in faults[:MAX_LISTED])
    more = f'\n  and {len(faults) - MAX_LISTED} more' if len(faults) > MAX_LISTED else ''
    return ValueError(f'{where}: {len(faults)} faults, nothing was converted{listed}{more}')


def manifest_faults(manifest: Any) -> list[str]:
    """Returns what is wrong with the manifest of a raw folder."""
    if not isinstance(manifest, dict) or not {'scene', 'dt', 'bounds', 'runs'} <= manifest.keys():
        return ['is not a manifest of raw runs (scene, dt, bounds, runs)']
    faults = []
    if not is_number(manifest['dt']) or manifest['dt'] <= 0:
        faults.append(f'dt is {manifest["dt"]!r}, a positive number of seconds was expected')
    faults += bounds_problems(manifest['bounds'])
    faults += _scene_faults(manifest['scene'])
    runs = manifest['runs']
    if not isinstance(runs, list):
        return [*faults, 'runs is no list']
    if not runs:
        return [*faults, 'lists no runs; let the solver finish at least one']
    return faults + _entry_faults(runs)


def _scene_faults(scene: Any) -> list[str]:
    lacking = [key for key in SCENE_KEYS if isinstance(scene, dict) and key not in scene]
    return [f'scene {scene!r} lacks {lacking}'] if lacking else scene_problems(scene)


def _entry_faults(runs: list[Any]) -> list[str]:
    faults = []
    for entry in runs:
        if (
            not isinstance(entry, dict)
            or not isinstance(entry.get('file'), str)
            or ENTRY_KEYS - entry.keys()
            or isinstance(entry['case'], bool)
            or not isinstance(entry['case'], (int, str))
        ):
            faults.append(
                f'a run is listed as {short(entry)}, not with {sorted(ENTRY_KEYS)}; '
                '`python -m pca_tools.convert --rehash` fills in what follows from the files'
            )
    cases = [str(entry.get('case')) for entry in runs if isinstance(entry, dict)]
    repeated = sorted({case for case in cases if cases.count(case) > 1})
    if repeated and not faults:
        faults.append(f'lists the cases [{", ".join(repeated)}] more than once')
    return faults


def array_faults(arrays: dict[str, np.ndarray], scene: dict[str, Any]) -> list[str]:
    """Returns what is wrong with the arrays of one run.

    Args:
        arrays: of the `.npz` file.
        scene: of the manifest.
    """
    wanted = ['positions', 'parameters']
    wanted += ['rigid_positions'] * (scene['rigid_motion'] != 'none')
    wanted += ['force'] * bool(scene['force'])
    lacking = [key for key in wanted if key not in arrays]
    faults = [f'lacks the arrays {lacking}'] if lacking else []
    soil = arrays.get('positions', np.empty(0))
    frames = len(soil) if soil.ndim else 0
    for name, shape in SERIES.items():
        if name not in arrays or (name == 'rigid_positions' and scene['rigid_motion'] == 'none'):
            continue
        values, ndim = arrays[name], 1 + len(shape)
        if name == 'step_context':
            shape = (len(scene['context_names']),)
        is_there = values.size and values.dtype.kind in 'fiu'
        if not is_there or not has_shape(values, frames, shape):
            wanted = ' x '.join('any' if size is None else str(size) for size in shape)
            faults.append(
                f'{name} has shape {values.shape}, {values.dtype} for {frames} frames of {wanted} '
                'values'
            )
        elif not np.all(np.isfinite(values)):
            bad = np.argwhere(~np.isfinite(values))
            faults.append(
                f'{name} holds {len(bad)} NaN or infinite values, the first at frame '
                f'{bad[0][0]}, ' + (f'point {bad[0][1]}' if ndim == 3 else f'axis {bad[0][1]}')
            )
    body = arrays.get('rigid_positions', np.empty((0, 0, 0)))
    highest = max((max(edge) for edge in scene['rigid_edges']), default=-1)
    if body.ndim == 3 and scene['rigid_motion'] != 'none' and highest >= body.shape[1]:
        faults.append(f'rigid_edges name point {highest}, the body has {body.shape[1]}')
    bodies = scene.get('bodies', [])
    if bodies and body.ndim == 3 and sum(b['points'] for b in bodies) != body.shape[1]:
        faults.append(
            f'has {body.shape[1]} rigid points, its bodies '
            f'{ {b["name"]: b["points"] for b in bodies} }'
        )
    for name in ('body_force', 'body_pose'):
        values = arrays.get(name, np.empty(0))
        if values.ndim == 3 and values.shape[1] != len(bodies):
            faults.append(f'{name} is of {values.shape[1]} bodies, the scene has {len(bodies)}')
    if 'parameters' in arrays:
        try:
            read_context(arrays, scene)
        except ValueError as error:
            faults.append(str(error))
    return faults


def read_context(
    arrays: dict[str, np.ndarray], scene: dict[str, Any]
) -> tuple[dict[str, Any], np.ndarray]:
    """Returns the parameters of a run and its context values, float64 [C].

    Raises:
        ValueError: no JSON object, or a context value is missing or not finite.
    """
    names = scene['context_names']
    try:
        parameters = json.loads(str(arrays['parameters']))
        context = np.array([float(parameters['context'][name]) for name in names])
        if not isinstance(parameters, dict) or not np.all(np.isfinite(context)):
            raise ValueError(f'context {context} is not finite')
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise ValueError(
            f'parameters must be a JSON object with context {names}: {error!r}'
        ) from error
    return parameters, context


@dataclasses.dataclass
class Extent:
    """Where soil and body are in all runs, and how fast they are.

    Attributes:
        low, high: [3] least and greatest soil coordinate in frame 0, metres.
        outside: share of the soil particles of first and last frames outside the bounds, the
            largest of all runs.
        spacing: median distance of a soil particle to its nearest neighbour, metres.
        speed, fastest: of the fastest point of soil or body, metres per second; which it is.
    """

    low: np.ndarray = dataclasses.field(default_factory=lambda: np.full(DIM, np.inf))
    high: np.ndarray = dataclasses.field(default_factory=lambda: np.full(DIM, -np.inf))
    outside: float = 0.0
    spacing: float = math.nan
    speed: float = 0.0
    fastest: str = 'soil'

    def add(
        self,
        positions: np.ndarray,
        rigid_positions: np.ndarray,
        dt: float,
        bounds: np.ndarray | None,
    ) -> None:
        """Takes one run in; arrays as of `pca_tools.raw_runs.RawRun`, bounds [3, 2] or None."""
        first = np.asarray(positions[0], np.float64)
        self.low = np.minimum(self.low, first.min(axis=0))
        self.high = np.maximum(self.high, first.max(axis=0))
        if math.isnan(self.spacing) and len(first) > 1:
            self.spacing = median_spacing(first)
        for name, points in (('soil', positions), ('body', rigid_positions)):
            if points.size and len(points) > 1:
                step = max(float(np.abs(b - a).max()) for a, b in zip(points[:-1], points[1:]))
                if step / dt > self.speed:
                    self.speed, self.fastest = step / dt, name
        if bounds is not None:
            ends = np.stack([positions[0], positions[-1]])
            out = np.any((ends < bounds[:, 0]) | (ends > bounds[:, 1]), axis=-1)
            self.outside = max(self.outside, float(out.mean()))


def unit_faults(extent: Extent, bounds: Any, dt: float) -> list[str]:
    """Returns what says that positions, bounds or dt are not in metres and seconds.

    Args:
        extent: of the runs.
        bounds: [[low, high]] * 3.
        dt: seconds per frame.
    """
    faults = []
    size = float(np.max(extent.high - extent.low))
    wanted = max(high - low for low, high in bounds)
    if extent.outside > 0.5 or size > 2 * wanted:
        ratio = float(np.max(np.abs([extent.low, extent.high]))) / np.max(np.abs(bounds))
        guess = _unit_guess(ratio)
        faults.append(
            f'{100 * extent.outside:.0f} % of the soil lies outside the bounds: it spans '
            f'{_span(extent)}, the bounds are {bounds}{guess}'
        )
    if not SPACING[0] <= extent.spacing <= SPACING[1] and math.isfinite(extent.spacing):
        faults.append(
            f'soil particles are {extent.spacing:.3g} m apart (median)'
            + _unit_guess(1000.0 if extent.spacing > SPACING[1] else 1.0)
        )
    if not EXTENT[0] <= size <= EXTENT[1]:
        faults.append(f'the soil spans {size:.3g} m')
    if extent.speed > SPEED:
        faults.append(
            f'the {extent.fastest} moves at {extent.speed:.3g} m/s ({extent.speed * dt:.3g} m in a '
            f'frame of {dt:.3g} s): the unit of length or dt is wrong'
        )
    if faults:
        faults.append(
            'metres and seconds are expected; if these are: --nocheck_units '
            '(check_units=False in write_raw)'
        )
    return faults


def _span(extent: Extent) -> str:
    return ', '.join(
        f'{axis} {low:.4g} .. {high:.4g}' for axis, low, high in zip(AXES, extent.low, extent.high)
    )


def _unit_guess(ratio: float) -> str:
    if 200 < ratio < 5000:
        return '; these look like millimetres: multiply all positions by 0.001'
    if 20 < ratio <= 200:
        return '; these look like centimetres: multiply all positions by 0.01'
    return ''


def infer_up_axis(extent: Extent, bounds: Any, gravity: Any = None) -> tuple[int | None, str]:
    """Finds the axis against gravity.

    Args:
        extent: of the runs.
        bounds: [[low, high]] * 3.
        gravity: vector of three numbers, if the runs state one.

    Returns:
        The axis or None, and what says so: the gravity vector; or that the soil lies at the bottom
        of the bounds, with free space above it, on that axis much more than on the others.
    """
    if isinstance(gravity, list) and len(gravity) == DIM and all(map(is_number, gravity)):
        if any(gravity):
            axis = int(np.argmax(np.abs(gravity)))
            return axis, f'gravity is {gravity}'
        return None, 'gravity is zero'
    bounds = np.asarray(bounds, np.float64)
    size = bounds[:, 1] - bounds[:, 0]
    lean = ((bounds[:, 1] - extent.high) - (extent.low - bounds[:, 0])) / size
    axis = int(np.argmax(lean))
    text = ', '.join(f'{name} {100 * value:z.0f} %' for name, value in zip(AXES, lean))
    reason = f'free space above the soil less that below it, of the bounds: {text}'
    others = np.delete(lean, axis)
    if lean[axis] < _ASYMMETRY or lean[axis] - others.max() < _ASYMMETRY:
        return None, reason
    return axis, reason
