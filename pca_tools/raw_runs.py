"""Raw solver runs: one `.npz` per run and a `manifest.json`.

The ground-truth solver writes them. The folder is trusted no further than its manifest: bytes and
sha256 are checked when a run is first opened.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pca_tools import files
from pca_tools.metadata import DIM, RIGID_MOTIONS

_RUN_KEYS = ('positions', 'rigid_positions', 'parameters')
# Arrays with a first axis of frames -> number of axes, length of the last one.
_SERIES = {
    'positions': (3, DIM),
    'rigid_positions': (3, DIM),
    'force': (2, DIM),
    'torque': (2, DIM),
    'pose': (2, 7),
}
_ENTRY_KEYS = {'file', 'case', 'bytes', 'sha256'}
_SCENE_KEYS = ('name', 'rigid_motion', 'rigid_edges', 'context_names', 'force')


@dataclasses.dataclass(frozen=True)
class RawRun:
    """One run of the solver, T frames.

    Attributes:
        case: its case id.
        positions: float32 [T, N, 3] soil particles, metres.
        rigid_positions: float32 [T, R, 3] points fixed to the rigid body, metres.
        force: float32 [T, 3] on the body, newtons, or None.
        context: float64 [C] global context values.
        parameters: all parameters of the case and of the solver.
        torque: float32 [T, 3] on the body about the position of `pose`, newton metres, or None.
        pose: float32 [T, 7] of the body, position (metres) and unit quaternion (w, x, y, z), or
            None.
    """

    case: int | str
    positions: np.ndarray
    rigid_positions: np.ndarray
    force: np.ndarray | None
    context: np.ndarray
    parameters: dict[str, Any]
    torque: np.ndarray | None = None
    pose: np.ndarray | None = None


class RawRuns(Sequence):
    """The finished runs of a raw folder, opened one at a time.

    Attributes:
        folder: the raw folder.
        scene: the scene as the solver wrote it.
        dt: seconds per frame.
        bounds: [[low, high]] * 3, metres.
        cases: case ids in manifest order.
    """

    def __init__(self, folder: str):
        """Reads the manifest.

        Raises:
            FileNotFoundError: the folder or its manifest is missing.
            ValueError: the manifest is not one of raw runs, lists nothing, or lists a case twice.
        """
        self.folder = folder
        path = os.path.join(folder, files.MANIFEST_NAME)
        if not os.path.isdir(folder):
            raise FileNotFoundError(f'{folder}: no such folder of raw runs')
        manifest = files.read_json(path)
        if (
            not isinstance(manifest, dict)
            or not {'scene', 'dt', 'bounds', 'runs'} <= manifest.keys()
        ):
            raise ValueError(f'{path}: is not a manifest of raw runs (scene, dt, bounds, runs)')
        self.scene: dict[str, Any] = manifest['scene']
        self.dt = manifest['dt']
        self.bounds = manifest['bounds']
        if (
            isinstance(self.dt, bool)
            or not isinstance(self.dt, (int, float))
            or not (0 < self.dt < math.inf)
        ):
            raise ValueError(f'{path}: dt is {self.dt!r}, a positive number was expected')
        lacking = [
            key for key in _SCENE_KEYS if not isinstance(self.scene, dict) or key not in self.scene
        ]
        if lacking or self.scene['rigid_motion'] not in RIGID_MOTIONS:
            raise ValueError(
                f'{path}: scene {self.scene!r} lacks {lacking} or has an unknown rigid_motion'
            )
        names = self.scene['context_names']
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ValueError(f'{path}: context_names is {names!r}, a list of texts was expected')
        self._entries = manifest['runs']
        if not isinstance(self._entries, list):
            raise ValueError(f'{path}: runs is no list')
        for entry in self._entries:
            if (
                not isinstance(entry, dict)
                or _ENTRY_KEYS - entry.keys()
                or not isinstance(entry['file'], str)
                or not isinstance(entry['case'], (int, str))
            ):
                raise ValueError(
                    f'{path}: a run is listed as {entry!r}, not with {sorted(_ENTRY_KEYS)}'
                )
        self.cases = [entry['case'] for entry in self._entries]
        if not self.cases:
            raise ValueError(f'{path}: lists no runs; let the solver finish at least one')
        repeated = sorted({case for case in self.cases if self.cases.count(case) > 1}, key=str)
        if repeated:
            raise ValueError(f'{path}: lists the cases {repeated} more than once')
        self._verified: set[int] = set()
        self._shape: tuple[int, ...] | None = None

    def __len__(self) -> int:
        return len(self._entries)

    def __getitem__(self, index: int) -> RawRun:
        """Opens run `index`.

        Raises:
            FileNotFoundError: the run's file is missing.
            ValueError: it differs from the manifest, lacks an array, has other counts than the runs
                opened before it, or holds NaN; the message names file, frame and point.
        """
        entry = self._entries[index]
        path = os.path.join(self.folder, os.path.basename(entry['file']))
        files.refuse_git_lfs_pointer(path)
        if index not in self._verified:
            if (os.path.getsize(path), files.sha256_of_file(path)) != (
                entry['bytes'],
                entry['sha256'],
            ):
                raise ValueError(
                    f'{path}: differs from the manifest ({os.path.getsize(path)} bytes, '
                    f'{entry["bytes"]} listed); delete it and let the solver make it again'
                )
            self._verified.add(index)
        run = self._parse(path, entry['case'], files.read_npz(path))
        shape = (
            *run.positions.shape[:2],
            run.rigid_positions.shape[1],
            run.torque is not None,
            run.pose is not None,
        )
        if self._shape is None:
            self._shape = shape
        if shape != self._shape:
            raise ValueError(
                f'{path}: has (frames, particles, rigid points, torque, pose) {shape}, the runs '
                f'before it {self._shape}'
            )
        return run

    def parameters(self, index: int) -> dict[str, Any]:
        """Returns the parameters of run `index`, from the manifest where it lists them."""
        listed = self._entries[index].get('parameters')
        return listed if isinstance(listed, dict) else self[index].parameters

    def _parse(self, path: str, case: int | str, arrays: dict[str, np.ndarray]) -> RawRun:
        lacking = [key for key in _RUN_KEYS if key not in arrays]
        if self.scene['force'] and 'force' not in arrays:
            lacking.append('force')
        if lacking:
            raise ValueError(f'{path}: lacks the arrays {lacking}')
        frames = arrays['positions'].shape[0] if arrays['positions'].ndim else 0
        for name, (ndim, width) in _SERIES.items():
            values = arrays.get(name)
            if values is None:
                continue
            if (
                values.dtype.kind not in 'fiu'
                or values.ndim != ndim
                or len(values) != frames
                or values.shape[-1] != width
                or not values.size
            ):
                raise ValueError(
                    f'{path}: {name} has shape {values.shape}, {values.dtype} for {frames} frames '
                    f'of {width} values'
                )
            if not np.all(np.isfinite(values)):
                bad = np.argwhere(~np.isfinite(values))
                raise ValueError(
                    f'{path}: {name} holds {len(bad)} NaN or infinite values, the first at frame '
                    f'{bad[0][0]}, ' + (f'point {bad[0][1]}' if ndim == 3 else f'axis {bad[0][1]}')
                )
        try:
            parameters = json.loads(str(arrays['parameters']))
            context = [float(parameters['context'][name]) for name in self.scene['context_names']]
            if not np.all(np.isfinite(context)):
                raise ValueError(f'context {context} is not finite')
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise ValueError(
                f'{path}: parameters must be a JSON object with context '
                f'{self.scene["context_names"]}: {error!r}'
            ) from error
        series = {
            name: np.asarray(arrays[name], np.float32) if name in arrays else None
            for name in _SERIES
        }
        if not self.scene['force']:
            series['force'] = None
        return RawRun(
            case=case, context=np.array(context, np.float64), parameters=parameters, **series
        )

    def __iter__(self) -> Iterator[RawRun]:
        return (self[index] for index in range(len(self)))


class SoilPositions(Sequence):
    """The soil positions [T, N, 3] of some runs, opened one at a time."""

    def __init__(self, runs: RawRuns, indices: Sequence[int], frame_stride: int = 1):
        """Takes every `frame_stride`-th frame of the runs `indices` of `runs`, in that order."""
        self._runs = runs
        self._indices = list(indices)
        self._stride = frame_stride

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, index: int) -> np.ndarray:
        return self._runs[self._indices[index]].positions[:: self._stride]
