"""Many runs of a scene into one folder: processes or a cluster, a manifest, resuming.

Kinds of runs that need another bin (`Scene.other_bins`) go into a folder of that name inside: all
runs of a folder start from the same packing.
"""

import functools
import os
from collections import Counter
from dataclasses import dataclass

from tqdm import tqdm

from mpm import SOLVER_VERSION, packing, raw_run, run, scenes
from mpm.motions import catalogue
from mpm.motions.recording import Recording
from mpm.simulation import Settings
from pca_tools import workers
from pca_tools.storage.folder_lock import locked
from pca_tools.storage.whole_files import remove_temporary


def generate(
    scene: scenes.Scene,
    cases: tuple,
    output_path: str,
    settings: Settings,
    num_processes: int = 1,
    tool: dict | None = None,
    where: str = '',
) -> list[dict]:
    """Simulates the runs that a folder does not hold yet; returns their entries of the manifest.

    All motions are checked before the first is simulated. A run that fails does not keep the others
    from being made; what is finished stays, and the same call goes on with the rest.

    Args:
        cases: what to run, see `catalogue.motion_of`.
        output_path: folder, made if absent; of a cluster on a disk that all workers see.
        num_processes: runs at a time.
        tool: `bodies.check_tool`, of all runs; None: what each run has.
        where: see `pca_tools.workers`; '': processes of this machine.

    Raises:
        ValueError: the folder holds another scene or other settings, another process writes into
            it, a motion is refused, or runs failed.
        OSError: the disk is full, a process was killed or the scheduler is gone.
    """
    _check_cases(scene, cases, settings, tool)
    groups: dict[str | None, list] = {}
    for case in cases:
        groups.setdefault(catalogue.bin_name(scene, case), []).append(case)
    new: list[dict] = []
    failures: list[str] = []
    for name, some in groups.items():
        folder = output_path if name is None else os.path.join(output_path, name)
        os.makedirs(folder, exist_ok=True)
        with locked(folder):
            remove_temporary(folder)
            job = _Job(catalogue.in_bin(scene, some[0]), settings, tool, folder)
            _generate(job, some, num_processes, where, new, failures)
    if failures:
        raise ValueError(
            f'{len(failures)} of {len(cases)} runs failed, {len(new)} were made and are kept in '
            f'{output_path}:\n  ' + '\n  '.join(failures)
        )
    return new


@dataclass(frozen=True)
class _Job:
    """What the runs of a folder share, the scene in the bin of the folder; goes to processes."""

    scene: scenes.Scene
    settings: Settings
    tool: dict | None
    folder: str

    def simulate(self, case, on_frame=lambda frame: None) -> dict | str:
        """Makes one run; returns its entry of the manifest, or why there is none."""
        try:
            packed = _packed(self.scene.bin, self.settings, self.folder)
            found = run.run_case(self.scene, case, packed, self.settings, on_frame, self.tool)
        except ValueError as error:  # it would fail again
            return str(error)
        return raw_run.write_run(self.folder, found)


@functools.lru_cache(maxsize=1)
def _packed(box, settings, folder) -> tuple:
    return packing.settled(box, settings.youngs_modulus, settings.seed, folder)


def _name(scene: scenes.Scene, case) -> str:
    return f'{scene.name} {case.path if isinstance(case, Recording) else f"case {case}"}'


def _check_cases(scene, cases, settings, tool) -> None:
    """Raises with the name of the first run whose motion is refused."""
    counts = Counter(map(catalogue.run_id, cases))
    if twice := sorted(str(name) for name, count in counts.items() if count > 1):
        raise ValueError(f'{scene.name}: the runs {twice} are named twice')
    for case in cases:
        try:
            run.prepared(catalogue.in_bin(scene, case), case, settings, tool)
        except ValueError as error:
            raise ValueError(f'{_name(scene, case)}: {error}') from error


def _unfinished(job: _Job, cases, finished: list[dict]) -> list:
    """Returns the cases that are not finished; refuses a path or tool of other content."""
    done, unfinished = {entry['case']: entry['parameters'] for entry in finished}, []
    for case in cases:
        name = catalogue.run_id(case)
        if name not in done:
            unfinished.append(case)
            continue
        asked, made = catalogue.motion_of(job.scene, case, job.tool).parameters, done[name]
        other = [key for key in ('path_sha256', 'tool') if asked.get(key) != made.get(key)]
        if other:
            raise ValueError(
                f'{job.folder}: {raw_run.file_name(name)} was made with another '
                f'{" and ".join(other)}; name another folder'
            )
    return unfinished


def _generate(job: _Job, cases, num_processes, where, new: list, failures: list) -> None:
    """Makes the runs of one folder; adds the new entries, and why others failed."""
    scene = job.scene
    shared = {'solver_version': SOLVER_VERSION, 'bin_m': list(scene.bin.size)}
    held = raw_run.finished_runs(job.folder, scene, job.settings.recorded() | shared)
    todo = _unfinished(job, cases, held)
    if not todo:
        return
    # Made once, before the workers would all make it.
    _packed(scene.bin, job.settings, job.folder)

    def note(case, result) -> None:
        """Adds a finished run to the manifest, or the reason why there is none to the failures."""
        if isinstance(result, str):
            failures.append(f'{_name(scene, case)}: {result}')
        else:
            new.append(result)
            held.append(result)
            raw_run.write_manifest(job.folder, scene, held)

    if not where and (num_processes == 1 or len(todo) == 1):
        for number, case in enumerate(todo):
            frames = catalogue.motion_of(scene, case, job.tool).simulated_frames
            title = f'{_name(scene, case)} ({number + 1} of {len(todo)})'
            with tqdm(total=frames, desc=title, unit='frame', mininterval=1.0) as bar:
                note(case, job.simulate(case, lambda frame, bar=bar: bar.update(frame - bar.n)))
        return
    with (
        workers.start(where, min(num_processes, len(todo))) as crew,
        tqdm(total=len(todo), desc=scene.name, unit='run') as bar,
    ):
        for outcome in crew.run(job.simulate, todo):
            case = todo[outcome.index]
            note(case, outcome.error if outcome.error is not None else outcome.value)
            bar.update()
