"""Converts raw solver runs to a dataset.

A dataset is `{train,valid,test}.tfrecord`, metadata, subspace, a sample of the particles of each
split (`particles_<split>.npz`), its heights where the raw runs have them (`heights_<split>.npz`),
and a manifest. The subspace is fitted on the training runs only, with one run in memory at a time.
Runs whose parameters name a split go there. All files are made in a folder beside the output, which
takes its name at the very end: it is there whole or not at all.

Examples:
    lts convert --raw_path=raw/excavation --output_path=datasets/excavation

    # 24 modes of hundreds of runs: the subspace from every fourth frame
    lts convert --raw_path=raw/driving --output_path=datasets/Driving \\
        --num_modes=24 --frame_stride=4

    # the published centering, two cases kept for the test split
    lts convert --raw_path=raw/wheel --output_path=datasets/Wheel \\
        --centering=scalar --hold_out=12,47

    # files of the raw folder were changed on purpose: let the manifest follow
    lts convert --raw_path=raw/own --rehash

    # new runs in the subspace of the dataset that a model was trained on; in the test split where
    # they name none
    lts convert --raw_path=raw/new --output_path=datasets/New \\
        --like=datasets/excavation

`pca_tools.append` adds runs to a dataset that is there.
"""

import contextlib
import os
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from absl import flags

from pca_tools import command, encode, files, particles, raw_runs, subspace, workers
from pca_tools.metadata import SPLITS
from pca_tools.raw_runs import RawRuns, SoilPositions
from pca_tools.storage import markdown

DEFAULT_SPLIT = (0.8, 0.1, 0.1)
# What must agree between raw runs and the dataset they are to fit; a scene may say more.
_SCENE_KEYS = (
    'name', 'rigid_motion', 'rigid_edges', 'context_names', 'force', 'up_axis', 'bodies', 'dim',
)  # fmt: skip
# Flags that say how a subspace is made and runs are dealt to splits, both of which --like fixes.
_FLAGS_WITHOUT_LIKE = (
    'num_modes', 'centering', 'split', 'seed', 'hold_out', 'frame_stride',
)  # fmt: skip
_FLAGS_AS_ARGUMENTS = (
    'centering', 'seed', 'hold_out', 'frame_stride', 'max_memory_mb', 'like', 'overwrite',
    'check_units', 'match_particles', 'cluster', 'packed',
)  # fmt: skip


def convert(
    raw_path: str,
    output_path: str,
    *,
    modes: int = 8,
    centering: str = 'configuration',
    split: Sequence[float] | None = None,
    seed: int = 0,
    hold_out: Sequence[int | str] = (),
    frame_stride: int = 1,
    max_memory_mb: float = 1024.0,
    like: str | None = None,
    overwrite: bool = False,
    check_units: bool = True,
    match_particles: bool = False,
    cluster: str | None = None,
    packed: bool = True,
) -> dict[str, Any]:
    """Converts a folder of raw runs; arguments as the flags of the same names. Returns the metadata
    of the new dataset. FileNotFoundError: a folder or file is missing. ValueError: bad raw runs,
    bad arguments, or an output folder that is not empty."""
    if frame_stride < 1:
        raise ValueError(f'frame_stride is {frame_stride}, at least 1 was expected')
    encode.refuse_occupied_output(output_path, overwrite)
    runs = RawRuns(raw_path)
    base, space = (None, None) if like is None else encode.load_space(like)
    runs.check(check_units, space, match_particles)
    first = runs[0]
    if runs.scene['rigid_motion'] != 'none' and first.rigid_pose is first.body_pose is None:
        text = 'its runs have no `pose` of the body: models of modes can be trained on them'
        warnings.warn(f'{raw_path}: {text}, the soil field cannot', stacklevel=2)
    if base is None:
        dealt = given_splits(runs, range(len(runs)), hold_out) if split is None else None
        dealt = dealt or split_cases(runs.cases, split or DEFAULT_SPLIT, seed, hold_out)
        with contextlib.nullcontext() if cluster is None else workers.start(cluster) as crew:
            wide = subspace.fit(
                SoilPositions(runs, dealt['train'], frame_stride), modes, centering, max_memory_mb,
                names=[str(runs.cases[index]) for index in dealt['train']],
                spare_modes=max(max(encode.FLOOR_MODES) - modes, 0), crew=crew,
            )  # fmt: skip
        space = wide.truncated(modes)
    else:
        refuse_other_scene(like, base, runs)
        trained = {run_key(case) for case in base.get('cases', {}).get('train', [])}
        every = list(range(len(runs)))
        if known := [runs.cases[i] for i in every if run_key(runs.parameters(i)) in trained]:
            raise ValueError(f'{like}: was trained on the cases {known}; they are no test of it')
        dealt = given_splits(runs, every, need_train=False) or {'test': every}
        wide = space
    sampled = particles.choose_particles(space.initial)
    parts = {
        name: encode.encode_runs(runs, part, wide, space.n_modes, sampled)
        for name, part in dealt.items()
        if part
    }
    metadata = encode.make_metadata(parts, space, runs.world, base, frame_stride, packed)
    contents = encode.Contents(parts, space, sampled, metadata, first.grid)
    encode.write(output_path, contents, overwrite)
    return metadata


def given_splits(
    runs: RawRuns,
    indices: Sequence[int],
    hold_out: Sequence[int | str] = (),
    need_train: bool = True,
) -> dict[str, list[int]] | None:
    """Deals the raw runs `indices` (ascending) to the splits that their parameters name, cases of
    `hold_out` to test: split -> indices, ascending; None if no case names one. ValueError: unknown
    names or ids, some that name none, or none in train where one is needed."""
    named = {index: runs.parameters(index).get('split') for index in indices}
    if all(split is None for split in named.values()):
        return None
    held = _known_ids(hold_out, runs.cases)
    parts: dict[str, list[int]] = {split: [] for split in SPLITS}
    faults = []
    for index, split in named.items():
        if str(runs.cases[index]) in held:
            parts['test'].append(index)
        elif split in SPLITS:
            parts[split].append(index)
        else:
            faults.append(f'{runs.cases[index]}: {split!r}')
    if faults:
        raise ValueError(
            f'{len(faults)} of {len(named)} cases name no split of {SPLITS} in their parameters '
            f'({", ".join(faults[:5])}), the others do; give --split to deal all of them anew'
        )
    if need_train and not parts['train']:
        raise ValueError('no case names train as its split: there is nothing to fit a subspace to')
    return parts


def _known_ids(hold_out: Sequence[int | str], cases: Sequence[int | str]) -> set[str]:
    held = set(map(str, hold_out))
    if unknown := held - set(map(str, cases)):
        raise ValueError(f'hold_out names {sorted(unknown)}, which are not among the cases')
    return held


def split_cases(
    cases: Sequence[int | str],
    fractions: Sequence[float],
    seed: int,
    hold_out: Sequence[int | str] = (),
) -> dict[str, list[int]]:
    """Deals cases to the splits by a seeded draw without replacement: split -> indices into
    `cases`, ascending. `fractions` are the shares of train, valid and test, sum 1; each above 0
    gets at least one case. Ids of `hold_out` go to test whatever the draw says, and count towards
    its share. ValueError: other shares, unknown ids, or too few cases."""
    if len(fractions) != len(SPLITS) or min(fractions) < 0 or abs(sum(fractions) - 1.0) > 1e-6:
        raise ValueError(f'split {list(fractions)} must be {len(SPLITS)} shares that sum to 1')
    held = _known_ids(hold_out, cases)
    shuffled = np.random.default_rng(seed).permutation(len(cases)).tolist()
    forced = [index for index in shuffled if str(cases[index]) in held]
    free = [index for index in shuffled if str(cases[index]) not in held]
    sizes = {
        split: max(round(share * len(cases)), 1) if share > 0 else 0
        for split, share in zip(SPLITS, fractions)
    }
    n_test, n_valid = max(sizes['test'] - len(forced), 0), sizes['valid']
    if n_test + n_valid >= len(free):
        raise ValueError(
            f'{len(cases)} cases with {len(forced)} held out do not fill the shares '
            f'{list(fractions)}; make more, or use --like to put them into an existing subspace'
        )
    return {
        'train': sorted(free[n_test + n_valid :]),
        'valid': sorted(free[n_test : n_test + n_valid]),
        'test': sorted(forced + free[:n_test]),
    }


def refuse_other_scene(like: str, base: dict[str, Any], runs: RawRuns) -> None:
    """Raises ValueError if the runs are of another scene than the dataset; warns of versions."""
    for key in _SCENE_KEYS:
        held, new = (scene.get(key) for scene in (base.get('scene', {}), runs.scene))
        if held != new:
            raise ValueError(
                f'{like}: is of another scene: its {key} is {held!r}, that of the raw runs {new!r}'
            )
    if base['dt'] != runs.dt:
        raise ValueError(f'{like}: has dt {base["dt"]}, the raw runs have {runs.dt}')
    trained = base.get('cases', {}).get('train', [])
    versions, new = (
        {str(case.get('solver_version', 'not stated')) for case in cases}
        for cases in (trained, map(runs.parameters, range(len(runs))))
    )
    if versions and not new <= versions:
        text = f'is of solver version {sorted(versions)}, the raw runs of {sorted(new)}'
        warnings.warn(f'{like}: {text}: errors will include what changed', stacklevel=2)


def run_key(parameters: dict[str, Any]) -> tuple[Any, str]:
    """What tells a run from all others: case numbers count anew in every kind."""
    return parameters.get('kind'), str(parameters.get('case'))


def summary(metadata: dict[str, Any], output_path: str) -> str:
    """Returns the closing lines: counts, truncation error and motion kept by split."""
    floors, rows = metadata['projection_floors'], []
    for split, values in metadata['projection_mse'].items():
        kept = encode.mean_share(metadata['motion_kept'][split], metadata['motion_mse'][split])
        rows.append((
            split, len(values), float(np.mean(values)), 1e3 * float(np.mean(values)) ** 0.5,
            max(metadata['projection_max_mm'][split]), f'{100 * kept:.2f}',
            *(1e3 * mse**0.5 for mse in floors[split]),
        ))  # fmt: skip
    header = (
        'split', 'runs', 'truncated MSE [m^2]', 'RMS [mm]', 'farthest [mm]', 'motion kept [%]',
        *(f'RMS that {count} modes leave [mm]' for count in floors['modes']),
    )  # fmt: skip
    entries = files.read_json(os.path.join(output_path, files.MANIFEST_NAME))['files'].values()
    n_bytes = sum(entry['bytes'] for entry in entries)
    return '\n'.join([
        f'{output_path}: scene {metadata["scene"]["name"]}, N = {metadata["n_soil"]}, '
        f'R = {metadata["particles_rigid"]}, r = {metadata["mode_number"]}, '
        f'T = {metadata["frames_stored"]}, centering {metadata["pca"]["centering"]}',
        markdown.table(header, rows, aligned=True),
        f'{sum(row[1] for row in rows)} runs in {1e-6 * n_bytes:.1f} MB',
    ])  # fmt: skip


def define_flags() -> None:
    flags.DEFINE_string('raw_path', None, 'Folder of raw solver runs.', required=True)
    flags.DEFINE_string('output_path', None, 'Folder of the new dataset.')
    flags.DEFINE_integer('num_modes', 8, 'Number of modes r to keep.')
    flags.DEFINE_enum(
        'centering', 'configuration', subspace.CENTERINGS,
        'Subtracted before the PCA: the mean position of each particle, or one number.',
    )  # fmt: skip
    flags.DEFINE_list('split', None, 'Shares of train, valid, test, if not as the runs say.')
    flags.DEFINE_integer('seed', 0, 'Seed of the split.')
    flags.DEFINE_list('hold_out', [], 'Case ids that go to the test split.')
    flags.DEFINE_integer('frame_stride', 1, 'Fit to every n-th frame of a training run.')
    flags.DEFINE_float('max_memory_mb', 1024.0, 'Memory of the fit in MiB, beside one run.')
    flags.DEFINE_string(
        'like', None, 'Dataset whose subspace is used; runs that name no split go to test.'
    )
    flags.DEFINE_bool('overwrite', False, 'Replace a finished dataset at --output_path.')
    flags.DEFINE_string(
        'cluster', None, 'Sum up the covariance on workers: local:4, slurm:64, tcp://host:port.'
    )
    flags.DEFINE_bool('packed', True, "Small records; --nopacked: for DeepMind's own reader.")
    flags.DEFINE_bool('rehash', False, 'First let the raw manifest follow its files.')
    define_check_flags()


def define_check_flags() -> None:
    """Defines the flags that say how raw runs are read, here and in `pca_tools.append`."""
    flags.DEFINE_bool(
        'check_units', True, 'Refuse positions and dt that are implausible in metres and seconds.'
    )
    flags.DEFINE_bool(
        'match_particles', False,
        'Reorder the particles of every run: each goes with its nearest neighbour in frame 0.',
    )  # fmt: skip


def main(values) -> None:
    if not (values.output_path or values.rehash):
        raise ValueError('--output_path is missing: the folder of the new dataset')
    idle = [f'--{name}' for name in _FLAGS_WITHOUT_LIKE if values[name].present]
    if values.like and idle:
        raise ValueError(f'{", ".join(idle)} do not go with --like: subspace and splits are given')
    if values.rehash:
        changed = raw_runs.rehash(values.raw_path)
        print(f'{values.raw_path}: the manifest has new entries for {len(changed)} files')
        if not values.output_path:
            return
    metadata = convert(
        values.raw_path, values.output_path, modes=values.num_modes,
        split=values.split and [float(share) for share in values.split],
        **{name: values[name].value for name in _FLAGS_AS_ARGUMENTS},
    )  # fmt: skip
    print(summary(metadata, values.output_path))


if __name__ == '__main__':
    define_flags()
    command.start_quietly(main)
