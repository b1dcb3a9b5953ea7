"""Raw runs: one `.npz` per run and a `manifest.json`; the format is in `docs/data.md`.

The ground-truth solver writes them, and `pca_tools.write_raw` for data of any other origin. The
folder is trusted no further than its manifest: bytes and sha256 are checked when a run is first
opened.
"""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pca_tools import files, matching, raw_checks
from pca_tools.dataset import FrameSeries
from pca_tools.metadata import AXES
from pca_tools.raw_checks import SERIES


@dataclasses.dataclass(frozen=True, eq=False)
class RawRun(FrameSeries):
    """One run of the solver, T frames.

    Attributes:
        case: its case id.
        positions: float32 [T, N, 3] soil particles, metres.
        rigid_positions: float32 [T, R, 3] points fixed to the rigid body, metres; R = 0 without
            one.
        context: float64 [C] global context values.
        parameters: all parameters of the case and of the solver.
    """

    case: int | str
    positions: np.ndarray
    rigid_positions: np.ndarray
    context: np.ndarray
    parameters: dict[str, Any]


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
            ValueError: the manifest is not one of raw runs; all of its faults are listed.
        """
        self.folder = folder
        path = os.path.join(folder, files.MANIFEST_NAME)
        if not os.path.isdir(folder):
            raise FileNotFoundError(f'{folder}: no such folder of raw runs')
        manifest = files.read_json(path)
        faults = raw_checks.manifest_faults(manifest)
        if faults:
            raise raw_checks.faults_error(path, faults)
        self.scene: dict[str, Any] = manifest['scene']
        self.dt: float = manifest['dt']
        self.bounds: list[list[float]] = manifest['bounds']
        self._entries = manifest['runs']
        self.cases = [entry['case'] for entry in self._entries]
        self._verified: set[int] = set()
        self._shape: tuple[int, ...] | None = None
        self._reference: np.ndarray | None = None
        self._orders: dict[int, np.ndarray] = {}

    @property
    def world(self) -> dict[str, Any]:
        """What all runs share: `scene`, `bounds` (m) and `dt` (s)."""
        return {'scene': self.scene, 'bounds': self.bounds, 'dt': self.dt}

    def __len__(self) -> int:
        return len(self._entries)

    def __getitem__(self, index: int) -> RawRun:  # type: ignore[override]
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
            size = os.path.getsize(path)
            if (size, files.sha256_of_file(path)) != (entry['bytes'], entry['sha256']):
                raise ValueError(
                    f'{path}: differs from the manifest ({size} bytes, {entry["bytes"]} listed); '
                    'copy it again from where it is whole, or, if it was changed on purpose, let '
                    'the manifest follow: python -m pca_tools.convert --rehash '
                    f'--raw_path={self.folder}'
                )
            self._verified.add(index)
        arrays = files.read_npz(path)
        faults = raw_checks.array_faults(arrays, self.scene)
        if faults:
            raise ValueError(f'{path}: ' + '; '.join(faults))
        run = self._run_of(arrays, entry['case'])
        shape = (run.positions.shape[1], run.torque is not None, run.rigid_pose is not None)
        if self._shape is None:
            self._shape = shape
        if shape != self._shape:
            raise ValueError(
                f'{path}: has (particles, torque, pose) {shape}, the runs before it {self._shape}; '
                'a dataset is of one bin: runs of another one need a folder of their own'
            )
        if self._reference is None:
            return run
        if index not in self._orders:
            self._orders[index] = matching.match_particles(run.positions[0], self._reference)
        return dataclasses.replace(run, positions=run.positions[:, self._orders[index]])

    def match_particles(self, reference: np.ndarray | None = None) -> None:
        """Lets all runs list their particles in one order: nearest neighbours in frame 0.

        Args:
            reference: [N, 3] metres; default frame 0 of the first run.
        """
        self._reference = self[0].positions[0] if reference is None else reference

    def _run_of(self, arrays: dict[str, np.ndarray], case: int | str) -> RawRun:
        series = {name: np.asarray(arrays[name], np.float32) for name in SERIES if name in arrays}
        if 'pose' in series:
            series['rigid_pose'] = series.pop('pose')
        if not self.scene['force']:
            series['force'] = None
        if self.scene['rigid_motion'] == 'none':
            series['rigid_positions'] = np.zeros((len(series['positions']), 0, 3), np.float32)
        parameters, context = raw_checks.read_context(arrays, self.scene)
        return RawRun(case=case, context=context, parameters=parameters, **series)

    def parameters(self, index: int) -> dict[str, Any]:
        """Returns the parameters of run `index`, from the manifest where it lists them."""
        listed = self._entries[index].get('parameters')
        return listed if isinstance(listed, dict) else self[index].parameters

    def __iter__(self) -> Iterator[RawRun]:
        return (self[index] for index in range(len(self)))

    def check(self, check_units: bool = True, progress=lambda sequence, label: sequence) -> None:
        """Opens every run and refuses the folder with all that is wrong with it.

        A scene that does not say which axis points up gets the one that gravity or the bounds tell,
        with a warning.

        Args:
            check_units: whether positions and dt must be plausible in metres and seconds.
            progress: wraps the pass, called with the sequence and a label.

        Raises:
            ValueError: faults of any run, implausible units, or no telling which axis points up.
        """
        extent, faults = raw_checks.Extent(), []
        bounds = np.asarray(self.bounds, np.float64)
        first = None
        for index in progress(range(len(self)), 'check'):
            try:
                run = self[index]
            except (ValueError, OSError) as error:
                faults.append(str(error))
                continue
            extent.add(run.positions, run.rigid_positions, self.dt, bounds)
            first = run if first is None else first
            begin, name = first.positions[0], f'case {first.case}'
            if fault := matching.order_fault(run.positions[0], begin, name):
                faults.append(f'case {run.case}: {fault}')
        if np.all(np.isfinite(extent.low)):
            if check_units:
                faults += raw_checks.unit_faults(extent, self.bounds, self.dt)
            faults += self._up_axis_faults(extent)
        if faults:
            raise raw_checks.faults_error(self.folder, faults)

    def _up_axis_faults(self, extent: raw_checks.Extent) -> list[str]:
        axis, reason = raw_checks.infer_up_axis(extent, self.bounds, self.scene.get('gravity'))
        stated = self.scene.get('up_axis')
        if stated is None and axis is None:
            return [
                'scene.up_axis is missing and cannot be inferred '
                f'({reason}); write it into the manifest: 0 (x), 1 (y) or 2 (z)'
            ]
        if stated is None:
            warnings.warn(
                f'{self.folder}: scene.up_axis is missing; {axis} ({AXES[axis]}) is taken, because '
                f'{reason}',
                stacklevel=3,
            )
            self.scene = {**self.scene, 'up_axis': axis}
        elif axis is not None and axis != stated:
            warnings.warn(
                f'{self.folder}: scene.up_axis is {stated} ({AXES[stated]}) but {AXES[axis]} looks '
                f'like the upward axis: {reason}',
                stacklevel=3,
            )
        return []


class SoilPositions(Sequence):
    """The soil positions [T, N, 3] of some runs, opened one at a time."""

    def __init__(self, runs: RawRuns, indices: Sequence[int], frame_stride: int = 1):
        """Takes every `frame_stride`-th frame of the runs `indices` of `runs`, in that order."""
        self._runs = runs
        self._indices = list(indices)
        self._stride = frame_stride

    def part(self, start: int, stop: int) -> SoilPositions:
        """Returns the runs from number `start` up to `stop`."""
        return SoilPositions(self._runs, self._indices[start:stop], self._stride)

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, index: int) -> np.ndarray:  # type: ignore[override]
        return self._runs[self._indices[index]].positions[:: self._stride]
