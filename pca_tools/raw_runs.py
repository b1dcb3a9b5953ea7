"""Raw runs: one `.npz` per run and a `manifest.json`; the format is in `docs/data.md`.

The ground-truth solver writes them, and `write_raw` here for data of any other origin; `rehash`
lets a manifest follow files that were changed on purpose. Nothing in the folder is trusted: bytes
and sha256 are held against the manifest when a run is first opened. Every check returns sentences,
so that a person learns of all faults at once.
"""

import dataclasses
import itertools
import json
import math
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from typing import Any

import numpy as np
from tqdm import tqdm

from pca_tools import files, heights, matching, metadata
from pca_tools.dataset import FRAME_SERIES, FrameSeries, series_fault
from pca_tools.heights import Grid
from pca_tools.metadata import AXES, DIM
from pca_tools.subspace import Subspace

# Arrays with a first axis of frames -> shape of a frame; None: as many as the scene has.
SERIES = {'positions': (None, DIM), 'rigid_positions': (None, DIM)} | {
    name.removeprefix('rigid_'): shape for name, shape in FRAME_SERIES.items()
}
SERIES['heights'] = (None, None)
SCENE_KEYS = ('name', 'rigid_motion', 'rigid_edges', 'context_names', 'force', 'up_axis')
ENTRY_KEYS = {'file', 'case', 'bytes', 'sha256'}
_RUN_KEYS = (*SERIES, 'case', 'context', 'parameters', 'split', 'kind')
# Bounds that are not given: the hull of soil and body, wider by this share of its size.
_MARGIN = 0.05
_FILE_NAME = 'run_{:05d}.npz'
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


@dataclasses.dataclass(frozen=True, eq=False)
class RawRun(FrameSeries):
    """One run of the solver, T frames."""

    case: int | str  # its case id
    positions: np.ndarray  # float32 [T, N, 3] soil particles, metres
    rigid_positions: np.ndarray  # float32 [T, R, 3] points fixed to the body, metres; R may be 0
    context: np.ndarray  # float64 [C] global context values
    parameters: dict[str, Any]  # all parameters of the case and of the solver
    heights: np.ndarray | None = None  # float32 [T, nx, nz] of the soil over the bin, metres
    grid: Grid | None = None  # where these lie

    @property
    def alike(self) -> 'Alike':
        """What all runs of a dataset share: N, whether they have a torque and a pose, the grid."""
        n_soil, pose = self.positions.shape[1], self.rigid_pose
        return n_soil, self.torque is not None, pose is not None, self.grid


Alike = tuple[int, bool, bool, Grid | None]


class RawRuns(Sequence):
    """The finished runs of a raw folder, opened one at a time."""

    def __init__(self, folder: str):
        """Reads the manifest. FileNotFoundError: the folder or its manifest is missing. ValueError:
        it is not one of raw runs; all of its faults are listed."""
        self.folder = folder
        path = os.path.join(folder, files.MANIFEST_NAME)
        if not os.path.isdir(folder):
            raise FileNotFoundError(f'{folder}: no such folder of raw runs')
        manifest = files.read_json(path)
        raise_faults(path, manifest_faults(manifest))
        self.world = {key: manifest[key] for key in ('scene', 'bounds', 'dt')}
        self.scene: dict[str, Any] = manifest['scene']  # as the solver wrote it
        self.dt: float = manifest['dt']  # s per frame
        self.bounds: list[list[float]] = manifest['bounds']  # [[low, high]] * 3, m
        self._entries = manifest['runs']
        self.cases = [entry['case'] for entry in self._entries]  # ids in manifest order
        self._verified: set[int] = set()
        self._first: Alike | None = None
        self._reference: np.ndarray | None = None
        self._orders: dict[int, np.ndarray] = {}

    def __len__(self) -> int:
        return len(self._entries)

    def __iter__(self) -> Iterator[RawRun]:  # that of Sequence takes an IndexError for the end
        return map(self.__getitem__, range(len(self)))

    def __getitem__(self, index: int) -> RawRun:  # type: ignore[override]
        """Opens run `index`; ValueError, with file, frame and point: it differs from the manifest,
        lacks an array, has other counts than the runs opened before it, or holds NaN."""
        entry = self._entries[index]
        path = os.path.join(self.folder, os.path.basename(entry['file']))
        files.refuse_git_lfs_pointer(path)
        if index not in self._verified:
            if files.fingerprint(path) != {key: entry[key] for key in ('bytes', 'sha256')}:
                raise ValueError(
                    f'{path}: differs from the manifest ({os.path.getsize(path)} bytes, '
                    f'{entry["bytes"]} listed); copy it again or, if that is on purpose, let the '
                    f'manifest follow: lts convert --rehash --raw_path={self.folder}'
                )
            self._verified.add(index)
        run = _read_run(path, self.scene, entry['case'])
        self._first = self._first or run.alike
        if problem := unlike(run, self._first):
            raise ValueError(f'{path}: {problem}')
        if self._reference is None:
            return run
        if index not in self._orders:
            self._orders[index] = matching.match_particles(run.positions[0], self._reference)
        return dataclasses.replace(run, positions=run.positions[:, self._orders[index]])

    def parameters(self, index: int) -> dict[str, Any]:
        """Returns the parameters of run `index`, from the manifest where it lists them, with its
        case id."""
        listed = self._entries[index].get('parameters')
        held = self[index].parameters if listed is None else listed
        return {**held, 'case': self.cases[index]}

    def check(
        self,
        check_units: bool = True,
        space: Subspace | None = None,
        match_particles: bool = False,
    ) -> None:
        """Opens every run and refuses the folder with all that is wrong with any, in one
        ValueError.

        Positions and dt must be plausible in metres and seconds if `check_units`. The runs must
        have the particles of `space`, in its order, by default those of the first run; with
        `match_particles` each goes with its nearest neighbour there in frame 0 from now on. Warns
        where gravity or the bounds tell another upward axis than the scene."""
        extent, faults = Extent(), []
        if match_particles:
            self._reference = space.initial if space else self[0].positions[0]
        reference = space and (space.initial, f'case {space.runs[0]}')
        for index in tqdm(range(len(self)), desc='check', unit='run'):
            try:
                run = self[index]
            except (ValueError, OSError) as error:
                faults.append(str(error))
                continue
            extent.add(run, self.dt)
            reference = reference or (run.positions[0], f'case {run.case}')
            if fault := matching.order_fault(run.positions[0], *reference):
                faults.append(f'case {run.case}: {fault}')
        if np.all(np.isfinite(extent.low)):
            if check_units:
                faults += unit_faults(extent, self.bounds, self.dt)
            gravity = self.scene.get('gravity')
            axis, reason = infer_up_axis(extent.low, extent.high, self.bounds, gravity)
            stated = self.scene['up_axis']
            if axis not in (None, stated):
                looks = f'{AXES[axis]} looks like the upward axis: {reason}'
                text = f'{self.folder}: scene.up_axis is {stated} ({AXES[stated]}) but {looks}'
                warnings.warn(text, stacklevel=2)
        raise_faults(self.folder, faults)


class SoilPositions(Sequence):
    """The soil positions [T, N, 3] of the runs `indices`, every `frame_stride`-th frame, opened one
    at a time."""

    def __init__(self, runs: RawRuns, indices: Sequence[int], frame_stride: int = 1):
        self._runs, self._indices, self._stride = runs, list(indices), frame_stride

    def part(self, start: int, stop: int) -> 'SoilPositions':
        return SoilPositions(self._runs, self._indices[start:stop], self._stride)

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, index: int) -> np.ndarray:  # type: ignore[override]
        return self._runs[self._indices[index]].positions[:: self._stride]


def raise_faults(where: str, faults: Sequence[str]) -> None:
    """Raises one ValueError that lists all faults of a file or folder, if there are any."""
    if len(faults) == 1:
        raise ValueError(f'{where}: {faults[0]}')
    if faults:
        listed = ''.join(f'\n  - {fault}' for fault in faults[:MAX_LISTED])
        more = f'\n  and {len(faults) - MAX_LISTED} more' if len(faults) > MAX_LISTED else ''
        raise ValueError(f'{where}: {len(faults)} faults, nothing was written{listed}{more}')


def manifest_faults(manifest: Any, entry_keys: Set[str] = ENTRY_KEYS) -> list[str]:
    """Returns what is wrong with a manifest whose runs must be listed with `entry_keys`."""
    if not isinstance(manifest, dict) or not {'scene', 'dt', 'bounds', 'runs'} <= manifest.keys():
        return ['is not a manifest of raw runs (scene, dt, bounds, runs)']
    scene, runs = manifest['scene'], manifest['runs']
    faults = metadata.problems_of(manifest, metadata.WORLD_CHECKS)
    lacking = [key for key in SCENE_KEYS if isinstance(scene, dict) and key not in scene]
    faults += [f'scene {scene!r} lacks {lacking}'] if lacking else metadata.scene_problems(scene)
    if not isinstance(runs, list) or not runs:
        return [*faults, 'lists no runs; let the solver finish at least one']
    wrong = [
        f'a run is listed as {metadata.short(entry)}, not with {sorted(entry_keys)}; '
        '`lts convert --rehash` fills in what follows from the files'
        for entry in runs
        if not isinstance(entry, dict)
        or entry_keys - entry.keys()
        or not isinstance(entry['file'], str)
        or not is_case(entry.get('case', 0))
        or not isinstance(entry.get('parameters', {}), dict)
    ]
    return faults + (wrong or repeated_cases([e['case'] for e in runs if 'case' in e]))


def is_case(value: Any) -> bool:
    return isinstance(value, (int, str)) and not isinstance(value, bool)


def repeated_cases(cases: Sequence[int | str]) -> list[str]:
    texts = [str(case) for case in cases]
    repeated = sorted({text for text in texts if texts.count(text) > 1})
    return [f'lists the cases [{", ".join(repeated)}] more than once'] if repeated else []


def _read_run(path: str, scene: dict[str, Any], case: int | str) -> RawRun:
    arrays = files.read_npz(path)
    try:
        return run_of(arrays, scene, case)
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from error


def run_of(arrays: dict[str, np.ndarray], scene: dict[str, Any], case: int | str) -> RawRun:
    """Returns the run that the arrays of a file hold in a scene of the manifest; ValueError with
    all that is wrong with them."""
    has_body = scene['rigid_motion'] != 'none'
    wanted = ['positions', 'parameters']
    wanted += ['rigid_positions'] * has_body + ['force'] * bool(scene['force'])
    lacking = [key for key in wanted if key not in arrays]
    faults = [f'lacks the arrays {lacking}'] if lacking else []
    soil = arrays.get('positions', np.empty(0))
    frames = len(soil) if soil.ndim else 0
    names, series = scene['context_names'], {}
    for name, shape in (SERIES | {'step_context': (len(names),)}).items():
        if name not in arrays or (name == 'rigid_positions' and not has_body):
            continue
        if fault := series_fault(arrays[name], name, frames, shape):
            faults.append(fault)
        else:
            series[name] = np.asarray(arrays[name], np.float32)
    bodies, body = scene.get('bodies', []), series.get('rigid_positions')
    if body is not None:
        highest = max((max(edge) for edge in scene['rigid_edges']), default=-1)
        if highest >= body.shape[1]:
            faults.append(f'rigid_edges name point {highest}, the body has {body.shape[1]}')
        counts = {one['name']: one['points'] for one in bodies}
        if bodies and sum(one['points'] for one in bodies) != body.shape[1]:
            faults.append(f'has {body.shape[1]} rigid points, its bodies {counts}')
    for name in ('body_force', 'body_pose'):
        if name in series and series[name].shape[1] != len(bodies):
            count = series[name].shape[1]
            faults.append(f'{name} is of {count} bodies, the scene has {len(bodies)}')
    try:
        parameters = json.loads(str(arrays.get('parameters', '{}')))
        context = np.array([float(parameters['context'][name]) for name in names])
        if not isinstance(parameters, dict) or not np.all(np.isfinite(context)):
            raise ValueError(f'context {context} is not finite')
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        faults.append(f'parameters must be a JSON object with context {names}: {error!r}')
    else:
        try:
            grid = heights.grid_of(parameters, series.get('heights'))
        except ValueError as error:
            faults.append(str(error))
    if faults:
        raise ValueError('; '.join(faults))
    series['rigid_pose'] = series.pop('pose', None)
    if not scene['force']:
        series['force'] = None
    series.setdefault('rigid_positions', np.zeros((frames, 0, DIM), np.float32))
    return RawRun(case=case, context=context, parameters=parameters, grid=grid, **series)


def unlike(run: RawRun, first: Alike) -> str:
    """Says what keeps a run out of a dataset whose first run is `first`; empty if nothing does."""
    if run.alike == first:
        return ''
    found = f'has (particles, torque, pose, height map) {run.alike}, the runs before it {first}'
    return f'{found}: record it again, or in a folder of its own'


@dataclasses.dataclass
class Extent:
    """Where the soil is in all runs, and how fast soil and body are."""

    # low, high: [3] least and greatest soil coordinate in frame 0, metres
    low: np.ndarray = dataclasses.field(default_factory=lambda: np.full(DIM, np.inf))
    high: np.ndarray = dataclasses.field(default_factory=lambda: np.full(DIM, -np.inf))
    spacing: float = math.nan  # median distance of a soil particle to its nearest neighbour, metres
    # speed, fastest: of the fastest point of soil or body, metres per second; which it is
    speed: float = 0.0
    fastest: str = 'soil'
    reach: float = 0.0  # largest coordinate of the maps of heights, metres; 0 without maps

    def add(self, run: RawRun, dt: float) -> None:
        self.reach = max(self.reach, heights.reach(run.heights, run.grid))
        first = np.asarray(run.positions[0], np.float64)
        self.low = np.minimum(self.low, first.min(axis=0))
        self.high = np.maximum(self.high, first.max(axis=0))
        if math.isnan(self.spacing):
            self.spacing = matching.median_spacing(first)
        for name, points in (('soil', run.positions), ('body', run.rigid_positions)):
            steps = (float(np.abs(b - a).max(initial=0)) for a, b in zip(points[:-1], points[1:]))
            speed = max(steps, default=0.0) / dt
            if speed > self.speed:
                self.speed, self.fastest = speed, name


def unit_faults(extent: Extent, bounds: Any, dt: float) -> list[str]:
    """Returns what says that positions, bounds ([[low, high]] * 3) or dt are not in metres and
    seconds."""
    faults = []
    size = float(np.max(extent.high - extent.low))
    low, high = np.asarray(bounds, np.float64).T
    middle = 0.5 * (extent.low + extent.high)
    if np.any((middle < low) | (middle > high)) or size > 2 * np.max(high - low):
        ratio = float(np.max(np.abs([extent.low, extent.high])) / np.max(np.abs(bounds)))
        spans = zip(AXES, extent.low, extent.high)
        span = ', '.join(f'{axis} {start:.4g} .. {end:.4g}' for axis, start, end in spans)
        found = f'it spans {span}, the bounds are {bounds}{_unit_guess(ratio)}'
        faults.append(f'the soil lies outside the bounds: {found}')
    if extent.reach > 2 * np.max(np.abs(bounds)):
        found = f'reaches {extent.reach:.4g} m, the bounds are {bounds}'
        faults.append(f'the height map {found}: heights, corner and cells are in metres')
    if not SPACING[0] <= extent.spacing <= SPACING[1] and math.isfinite(extent.spacing):
        guess = _unit_guess(1000.0 if extent.spacing > SPACING[1] else 1.0)
        faults.append(f'soil particles are {extent.spacing:.3g} m apart (median){guess}')
    if not EXTENT[0] <= size <= EXTENT[1]:
        faults.append(f'the soil spans {size:.3g} m')
    if extent.speed > SPEED:
        found = f'{extent.speed:.3g} m/s ({extent.speed * dt:.3g} m in a frame of {dt:.3g} s)'
        faults.append(f'the {extent.fastest} moves at {found}: the unit of length or dt is wrong')
    if faults:
        faults.append('if these are metres and seconds: --nocheck_units (check_units=False)')
    return faults


def _unit_guess(ratio: float) -> str:
    if 200 < ratio < 5000:
        return '; these look like millimetres: multiply all positions by 0.001'
    if 20 < ratio <= 200:
        return '; these look like centimetres: multiply all positions by 0.01'
    return ''


def infer_up_axis(
    lowest: np.ndarray, highest: np.ndarray, bounds: Any, gravity: Any = None
) -> tuple[int | None, str]:
    """Finds the axis against gravity, or None, and what says so: the gravity vector, if the runs
    state one; or that the soil, from `lowest` to `highest` [3], lies at the bottom of the bounds
    ([[low, high]] * 3), with free space above it, on that axis much more than on the others."""
    if isinstance(gravity, list) and len(gravity) == DIM and all(map(metadata.is_number, gravity)):
        if not any(gravity):
            return None, 'gravity is zero'
        return int(np.argmax(np.abs(gravity))), f'gravity is {gravity}'
    low, high = np.asarray(bounds, np.float64).T
    lean = ((high - highest) - (lowest - low)) / (high - low)
    axis = int(np.argmax(lean))
    text = ', '.join(f'{name} {100 * value:z.0f} %' for name, value in zip(AXES, lean))
    reason = f'free space above the soil less that below it, of the bounds: {text}'
    is_clear = lean[axis] >= _ASYMMETRY and lean[axis] - np.delete(lean, axis).max() >= _ASYMMETRY
    return axis if is_clear else None, reason


def write_raw(
    folder: str,
    runs: Iterable[Mapping[str, Any]],
    dt: float,
    *,
    up_axis: int | str,
    body: str | None = None,
    bounds: Sequence[Sequence[float]] | None = None,
    rigid_edges: Sequence[Sequence[int]] = (),
    name: str = 'own_data',
    gravity: Sequence[float] | None = None,
    bodies: Sequence[Mapping[str, Any]] | None = None,
    check_units: bool = True,
) -> None:
    """Writes runs as a folder that `lts convert --raw_path=FOLDER` takes.

    Args:
        folder: absent or empty; it is there whole or not at all.
        runs: one mapping per run, taken one at a time (a generator will do). `positions`
            [T, N, D] is needed; the rest is optional, but the same in all runs:
            `rigid_positions` [T, R, D] points fixed to the body, `force` [T, D] and `torque`
            [T, 3] on it, its `pose` [T, 7] (position, quaternion w x y z), `context` (name ->
            number), `step_context` [T, C] where that changes in time, `case` (id; default its
            index), `split` (train, valid or test), `kind`, and `parameters` (anything JSON can
            hold). `heights` [T, nx, nz] of the soil's surface are coordinates along the upward
            axis; the `parameters` then say where the map lies: `heights_corner_m` [x, z] and
            `heights_cell_m` [dx, dz], the same in all runs. Metres, newtons; D = 2 or 3, a third
            coordinate of 0 is added to 2. T and R may differ from run to run, N may not: particle i
            is the same particle in all runs.
        dt: seconds from frame to frame.
        up_axis: axis against gravity, 0, 1, 2 or 'x', 'y', 'z'.
        body: what is known of the body's motion beforehand: 'prescribed' (all), 'driven' (rotation
            and travel, the height is predicted), 'predicted' (nothing), or 'none' (no body).
            Default: 'prescribed' where there are `rigid_positions`, else 'none'.
        bounds: [low, high] of every axis, which no particle leaves; default the hull of all soil
            and bodies with a margin.
        rigid_edges: pairs of rigid points that hold the body's shape, for bodies whose motion is
            not prescribed.
        name: of the scene.
        gravity: vector, m/s^2; recorded, and held against `up_axis`.
        bodies: of several bodies, in the order of their points: `name`, `rigid_motion` and `points`
            (how many of R) of each. `rigid_edges` join points of one body; runs may then have
            `body_force` [T, B, 3] and `body_pose` [T, B, 7], and `force` is the sum. Runs with a
            free body may have `target` and `external` [T, 3] and `subframe_force` [T, 4, 3].
        check_units: refuse positions and dt that are implausible in metres and seconds.

    Raises:
        ValueError: all faults of all runs, before the folder exists; a folder that is not empty.
        OSError: it cannot be written.
    """
    runs = iter(runs)
    first = next(runs, None)
    if first is None:
        raise ValueError(f'{folder}: no runs were given')
    scene: dict[str, Any] = {
        'name': name,
        'rigid_motion': body or ('prescribed' if 'rigid_positions' in first else 'none'),
        'rigid_edges': [[int(a), int(b)] for a, b in rigid_edges],
        'context_names': list(first.get('context') or {}),
        'force': 'force' in first,
        'up_axis': AXES.index(up_axis) if up_axis in AXES else up_axis,
    }
    if bodies is not None:
        scene['bodies'] = [dict(body) for body in bodies]
    if gravity is not None:
        scene['gravity'] = [float(value) for value in gravity]
    if np.ndim(first.get('positions')) == 3 and np.shape(first['positions'])[2] == 2:
        scene['dim'] = 2
    manifest = {
        'scene': scene,
        'dt': dt,
        'bounds': [[0.0, 1.0]] * 3 if bounds is None else [list(map(float, b)) for b in bounds],
        'runs': [dict.fromkeys(ENTRY_KEYS, '')],
    }
    raise_faults(folder, manifest_faults(manifest))

    def fill(temporary: str) -> None:
        every = itertools.chain([first], runs)
        _write_runs(temporary, every, manifest, bounds is None, check_units)
        files.write_json(os.path.join(temporary, files.MANIFEST_NAME), manifest)

    files.write_folder_atomically(folder, fill, replace=False)


def _write_runs(folder, runs, manifest, find_bounds, check_units) -> None:
    """Writes all runs, and their entries (and bounds, where none are given) into the manifest."""
    scene, dt = manifest['scene'], manifest['dt']
    extent, entries, faults, corners, first = Extent(), [], [], [], None
    for index, given in enumerate(runs):
        try:
            arrays = _arrays_of(index, given, scene)
            run = run_of(arrays, scene, index)
            first = first or run.alike
            problem = unlike(run, first)
        except ValueError as error:
            problem = str(error)
        if problem:
            faults.append(f'run {index}: {problem}')
            continue
        extent.add(run, dt)
        points = np.concatenate([run.positions, run.rigid_positions], axis=1)
        corners += [points.min(axis=(0, 1)), points.max(axis=(0, 1))]
        if not faults:  # after the first fault the rest is only looked at
            name = _FILE_NAME.format(index)
            files.write_npz(os.path.join(folder, name), **arrays)
            entries.append(_entry(folder, {'file': name}, run.parameters))
    faults += repeated_cases([entry['case'] for entry in entries])
    if corners and find_bounds:
        low, high = np.float64(np.min(corners, axis=0)), np.float64(np.max(corners, axis=0))
        margin = _MARGIN * max(float(np.max(high - low)), 1e-9)
        manifest['bounds'] = np.stack([low - margin, high + margin], axis=1).tolist()
    if corners and check_units:
        faults += unit_faults(extent, manifest['bounds'], dt)
    raise_faults('write_raw', faults)
    manifest['runs'] = entries


def _arrays_of(index: int, run: Mapping[str, Any], scene: dict[str, Any]) -> dict[str, np.ndarray]:
    """Returns the arrays to write of one run; ValueError with what is wrong with its keys."""
    if unknown := sorted(set(run) - set(_RUN_KEYS)):
        raise ValueError(f'has the unknown keys {unknown}; known are {list(_RUN_KEYS)}')
    faults, arrays = [], {}
    for name in SERIES:
        if run.get(name) is None:
            continue
        values = np.asarray(run[name])
        is_plane = scene.get('dim') == 2 and values.ndim and values.shape[-1] == 2
        if is_plane and SERIES[name][-1] == DIM:
            values = np.concatenate([values, np.zeros((*values.shape[:-1], 1))], axis=-1)
        arrays[name] = values.astype(np.float32) if values.dtype.kind in 'fiu' else values
    context = run.get('context') or {}
    if sorted(context) != sorted(scene['context_names']):
        faults.append(f'context has {sorted(context)}, run 0 {sorted(scene["context_names"])}')
    if ('force' in arrays) != scene['force']:
        faults.append(f'{"has" if "force" in arrays else "lacks"} force, unlike run 0')
    parameters = {**(run.get('parameters') or {}), 'case': run.get('case', index)}
    parameters |= {key: run[key] for key in ('split', 'kind') if run.get(key) is not None}
    if not is_case(parameters['case']):
        faults.append(f'case is {parameters["case"]!r}, a whole number or a text was expected')
    try:
        parameters['context'] = {key: float(value) for key, value in context.items()}
        arrays['parameters'] = np.array(json.dumps(parameters, allow_nan=False))
    except (TypeError, ValueError) as error:
        faults.append(f'parameters, with the context {context}, cannot be written: {error}')
    if faults:
        raise ValueError('; '.join(faults))
    return arrays


def _entry(folder: str, listed: dict[str, Any], parameters: dict[str, Any]) -> dict[str, Any]:
    """Returns what the manifest says of a run; what was listed of it stays."""
    case = listed.get('case', parameters.get('case', os.path.splitext(listed['file'])[0]))
    path = os.path.join(folder, os.path.basename(listed['file']))
    return {**listed, 'case': case, **files.fingerprint(path), 'parameters': parameters}


def rehash(folder: str) -> list[str]:
    """Lets the manifest of a raw folder follow its files, which are read, never changed; returns
    the names of those whose entries changed.

    Bytes, sha256 and parameters of every listed run become those of its file; a case id that is
    missing becomes that of the parameters, else the name of the file. The manifest may list runs by
    `file` alone. FileNotFoundError: there is none. ValueError: all faults of the manifest and of
    the files; nothing was changed."""
    path = os.path.join(folder, files.MANIFEST_NAME)
    manifest = files.read_json(path)
    raise_faults(path, manifest_faults(manifest, {'file'}))
    entries, faults = [], []
    for entry in manifest['runs']:
        file = os.path.join(folder, os.path.basename(entry['file']))
        try:
            parameters = _read_run(file, manifest['scene'], '').parameters
            entries.append(_entry(folder, entry, parameters))
        except (ValueError, OSError) as error:
            faults.append(str(error))
    changed = [new['file'] for old, new in zip(manifest['runs'], entries) if old != new]
    manifest = {**manifest, 'runs': entries}
    raise_faults(path, faults or manifest_faults(manifest))
    files.write_json(path, manifest)
    return changed
