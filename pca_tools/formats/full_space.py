"""Trajectories in full space: all particles with their types, as other projects keep them.

Types are DeepMind's: 0 rigid, 3 kinematic (boundary, prescribed), 5 water, 6 sand, 7 goop; every
format maps its own to these.
"""

import dataclasses
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pca_tools import files, raw_runs
from pca_tools.dataset import KINEMATIC_PARTICLE_ID, RIGID_PARTICLE_ID
from pca_tools.metadata import METADATA_NAME, SPLITS, WORLD_CHECKS, is_number, problems_of

SOIL_TYPE = 6
BODY_TYPES = (RIGID_PARTICLE_ID, KINEMATIC_PARTICLE_ID)


@dataclasses.dataclass(frozen=True, eq=False)
class FullSpaceRun:
    """One trajectory."""

    name: str  # case id
    split: str  # train, valid or test; empty where the data do not say
    positions: np.ndarray  # float [T, P, D]
    particle_type: np.ndarray  # int [P], DeepMind's numbers
    # force, context: float [T, D] on the body and [T, C], global; None where there is none
    force: np.ndarray | None = None
    context: np.ndarray | None = None


@dataclasses.dataclass
class FullSpaceData:
    """Trajectories of one folder, opened one at a time; what nothing says is None."""

    source: str  # what it is and where, for messages
    runs: Callable[[], Iterator[FullSpaceRun]]  # may be called again
    dt: float | None = None  # seconds per stored frame
    bounds: list[list[float]] | None = None  # [[low, high]] * D
    up_axis: int | None = None  # 0, 1 or 2
    context_names: list[str] = dataclasses.field(default_factory=list)
    rigid_motion: str | None = None  # of the body, where the data say more than its type does
    radius: float | None = None  # connectivity radius of an export
    name: str = 'soil'  # of the scene
    notes: list[str] = dataclasses.field(default_factory=list)  # for the person who imports


class Foreign:
    """`metadata.json` of another project: its path, and its values; FileNotFoundError, ValueError
    if it is absent or no JSON object."""

    def __init__(self, folder: str):
        self.path = os.path.join(folder, METADATA_NAME)
        self.values = files.read_json(self.path)
        if not isinstance(self.values, dict):
            raise ValueError(f'{self.path}: a JSON object was expected')

    def number(self, key: str) -> float | None:
        """Returns a finite number as float, None where the key is absent or null."""
        value = self.values.get(key)
        if value is None or is_number(value):
            return None if value is None else float(value)
        raise ValueError(f'{self.path}: {key} is {value!r}, a number was expected')

    def data(
        self, title: str, ending: str, read: Callable, dt: float | None, **others
    ) -> FullSpaceData:
        """Returns the data of a folder of `{train,valid,test}.<ending>` beside these metadata.
        `read` gives an iterator over (name, arrays of a `FullSpaceRun`) of the runs of a path; `dt`
        is given by a person, else that of the metadata."""
        folder = os.path.dirname(self.path)

        def runs() -> Iterator[FullSpaceRun]:
            for split in SPLITS:
                path = os.path.join(folder, f'{split}.{ending}')
                for name, arrays in read(path) if os.path.exists(path) else ():
                    run = FullSpaceRun(f'{split}_{name}', split, **arrays)
                    yield check_run(run, f'{path}: run {name}')

        bounds = bounds_of(self.values, self.path)
        return FullSpaceData(f'{folder} ({title})', runs, dt or self.number('dt'), bounds, **others)


def bounds_of(metadata: Mapping[str, Any], where: str) -> list[list[float]] | None:
    """Returns `bounds` of the metadata, of two or three axes, None where absent."""
    bounds = metadata.get('bounds')
    if bounds is None:
        return None
    third = [[0.0, 1.0]] * (isinstance(bounds, list) and len(bounds) == 2)
    if problems := problems_of({'bounds': bounds + third if third else bounds}, WORLD_CHECKS):
        raise ValueError(f'{where}: {problems[0]}')
    return [[float(low), float(high)] for low, high in bounds]


def check_run(run: FullSpaceRun, where: str) -> FullSpaceRun:
    """Returns a run whose arrays fit each other; ValueError, with `where`, if they do not."""
    positions = run.positions
    if positions.dtype.kind not in 'fiu' or positions.ndim != 3 or positions.shape[2] not in (2, 3):
        found = f'{positions.shape}, {positions.dtype}'
        raise ValueError(f'{where}: positions have shape {found}; [T, particles, 2 or 3] expected')
    for name in ('force', 'context'):
        values = getattr(run, name)
        if values is not None and (values.ndim != 2 or len(values) != len(positions)):
            raise ValueError(f'{where}: {name} has {values.shape} for {len(positions)} frames')
    return run


def particle_types(values: Any, positions: np.ndarray, where: str) -> np.ndarray:
    """Returns the types of the particles of positions [T, P, D] as int64 [P]; one number stands for
    all particles. ValueError, with `where`: they are not whole numbers or do not fit."""
    array = np.asarray(values)
    if positions.ndim != 3:
        raise ValueError(f'{where}: positions have shape {positions.shape}, [T, N, D] was expected')
    if array.dtype.kind not in 'fiu' or not (array == np.rint(array)).all():
        raise ValueError(f'{where}: particle types are not whole numbers ({array.dtype})')
    count = positions.shape[1]
    if array.size not in (1, count):
        raise ValueError(f'{where}: {count} particles have types of shape {array.shape}')
    return np.full(count, array.ravel(), np.int64)


def find_up_axis(data: FullSpaceData, bounds: list[list[float]]) -> tuple[int | None, str]:
    """Infers the axis against gravity from where the soil lies in the bounds."""
    soil = np.concatenate([
        in_space(run.positions[0, ~np.isin(run.particle_type, BODY_TYPES)]).astype(np.float64)
        for run in data.runs()
    ])  # fmt: skip
    lowest, highest = soil.min(axis=0, initial=np.inf), soil.max(axis=0, initial=-np.inf)
    return raw_runs.infer_up_axis(lowest, highest, bounds)


def raw_mappings(data: FullSpaceData, body: str | None) -> Iterator[dict[str, Any]]:
    """Yields the runs as `pca_tools.write_raw` takes them: soil and body apart, for the motion
    `none` of the body soil alone. ValueError: a run has no soil, two moving bodies, or other
    particles than the first."""
    first = None
    for run in data.runs():
        where = f'{data.source}: {run.name}'
        soil, points = split_bodies(run, where)
        first = first or (soil.shape[1], run.name)
        if soil.shape[1] != first[0]:
            raise ValueError(
                f'{where}: has {soil.shape[1]} soil particles, {first[1]} {first[0]}: a common '
                'subspace needs one number; for several there is train --model=full_space'
            )
        mapping: dict[str, Any] = {'positions': soil, 'case': run.name}
        if run.split:
            mapping['split'] = run.split
        if points.shape[1] and body != 'none':
            mapping['rigid_positions'] = points
            if run.force is not None:
                mapping['force'] = run.force
        if run.context is not None:
            if np.any(run.context != run.context[0]):
                mapping['step_context'] = run.context
            mapping['context'] = dict(zip(data.context_names, run.context[0].tolist(), strict=True))
        yield mapping


def split_bodies(run: FullSpaceRun, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns soil [T, N, D] and the points of the body [T, R, D] of a run. A boundary that never
    moves is no body where there is a rigid one: the bounds hold the soil. ValueError: no soil, or a
    rigid body beside a moving boundary."""
    rigid, kinematic = (run.particle_type == kind for kind in BODY_TYPES)
    soil = run.positions[:, ~(rigid | kinematic)]
    if not soil.shape[1]:
        raise ValueError(f'{where}: all of its particles are rigid or boundary: there is no soil')
    if rigid.any() and kinematic.any():
        walls = run.positions[:, kinematic]
        if np.any(walls != walls[0]):
            both = 'a rigid body (type 0) and a moving boundary (type 3)'
            raise ValueError(f'{where}: has {both}; one body is read: change the types of one')
        return soil, run.positions[:, rigid]
    return soil, run.positions[:, rigid | kinematic]


def body_motion(data: FullSpaceData) -> str:
    """Returns what is known of the body's motion: stated, else as the types say."""
    if data.rigid_motion:
        return data.rigid_motion
    types = {int(kind) for run in data.runs() for kind in np.unique(run.particle_type)}
    if RIGID_PARTICLE_ID in types:
        return 'predicted'
    return 'prescribed' if KINEMATIC_PARTICLE_ID in types else 'none'


def by_split(data: FullSpaceData) -> dict[str, Callable[[], Iterator[FullSpaceRun]]]:
    """Returns split -> a function that gives an iterator over its runs; only splits with runs."""

    def runs_of(split: str) -> Callable[[], Iterator[FullSpaceRun]]:
        return lambda: (run for run in data.runs() if run.split == split)

    return {split: runs_of(split) for split in SPLITS if next(runs_of(split)(), None) is not None}


def length_of(lengths: Iterable[int]) -> int:
    """Returns the number of frames that all runs have; ValueError if they have different ones."""
    found = sorted(set(lengths))
    if len(found) != 1:
        raise ValueError(f'runs have {found} frames, this format holds runs of one length')
    return found[0]


def common_metadata(
    data: FullSpaceData, train: Iterable[FullSpaceRun], more: Sequence[str] = ()
) -> dict[str, Any]:
    """Returns what the metadata of all formats hold, with means and deviations of training runs:
    `vel_mean, vel_std, acc_mean, acc_std` are DeepMind's, per frame, not divided by dt, over all
    particles that are not kinematic; `more` may name `rigid_body_force` and `context`, where runs
    have them. Float64 sums, one run in memory at a time."""
    sums: dict[str, np.ndarray] = {}  # name -> rows of count, sum, sum of squares
    for run in train:
        moving = run.positions[:, run.particle_type != KINEMATIC_PARTICLE_ID].astype(np.float64)
        for name, values in (
            ('vel', np.diff(moving, axis=0)), ('acc', np.diff(moving, n=2, axis=0)),
            ('rigid_body_force', run.force), ('context', run.context),
        ):  # fmt: skip
            if values is not None and values.size and name in ('vel', 'acc', *more):
                flat = values.reshape(-1, values.shape[-1]).astype(np.float64)
                held = sums.setdefault(name, np.zeros((3, flat.shape[1])))
                held += [np.full(flat.shape[1], len(flat)), flat.sum(axis=0), (flat**2).sum(axis=0)]
    moments = {}
    for name, (count, total, squares) in sums.items():
        mean = total / count
        moments[f'{name}_mean'] = mean.tolist()
        moments[f'{name}_std'] = np.sqrt(np.maximum(squares / count - mean**2, 0.0)).tolist()
    return {
        'bounds': data.bounds,
        'default_connectivity_radius': data.radius or 0.025,
        'dim': next(data.runs()).positions.shape[2],
        'dt': data.dt,
        **moments,
    }


def in_space(positions: np.ndarray) -> np.ndarray:
    """Adds a third coordinate of 0 to positions [..., 2] in the plane."""
    if positions.shape[-1] == 3:
        return positions
    return np.concatenate([positions, np.zeros_like(positions[..., :1])], axis=-1)
