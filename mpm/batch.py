"""Many runs of a scene into one folder: a pool of processes, a manifest, resuming."""

import concurrent.futures
import multiprocessing
import os
from concurrent.futures.process import BrokenProcessPool

from tqdm import tqdm

from mpm import packing, raw_run, run, scenes, versions
from mpm.constitutive import make_soil
from mpm.files import one_writer, remove_temporary
from mpm.motions.catalogue import motion_of
from mpm.motions.recording import Recording
from mpm.simulation import Settings
from storage import parent


def generate(
    scene: scenes.Scene,
    cases: tuple,
    output_path: str,
    settings: Settings,
    num_processes: int = 1,
    show_progress: bool = True,
) -> list[dict]:
    """Simulates the runs that a folder does not hold yet.

    All motions are checked before the first is simulated. A run that fails does not keep the others
    from being made; what is finished stays, and the same call goes on with the rest.

    Args:
        scene: the scene.
        cases: what to run, see `catalogue.motion_of`.
        output_path: folder, made if absent.
        settings: of all runs in the folder.
        num_processes: runs at a time.
        show_progress: whether to draw bars.

    Returns:
        The manifest entries of the new runs.

    Raises:
        ValueError: if the folder holds another scene or other settings, another process writes into
            it, a motion is refused, or runs failed.
        OSError: if the disk is full or a process was killed.
    """
    _check_cases(scene, cases, settings)
    os.makedirs(output_path, exist_ok=True)
    with one_writer(output_path):
        remove_temporary(output_path)
        return _generate(scene, cases, output_path, settings, num_processes, show_progress)


def _name(scene: scenes.Scene, case) -> str:
    if isinstance(case, Recording):
        return f'{scene.name} {case.path}'
    return f'{scene.name} case {case}'


def _check_cases(scene, cases, settings) -> None:
    """Raises with the name of the first run whose motion is refused."""
    names = [case.case if isinstance(case, Recording) else case for case in cases]
    twice = sorted({str(name) for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f'{scene.name}: the runs {twice} are named twice')
    for case in cases:
        try:
            run.check_motion(scene, motion_of(scene, case), settings)
        except ValueError as error:
            raise ValueError(f'{_name(scene, case)}: {error}') from error


def _unfinished(scene, cases, finished: list[dict], folder: str) -> list:
    """Returns the cases that are not among the finished; refuses a path of other content."""
    done = {entry['case']: entry['parameters'] for entry in finished}
    for case in cases:
        if isinstance(case, Recording) and case.case in done:
            made, asked = done[case.case], motion_of(scene, case).parameters
            if any(made.get(name) != value for name, value in asked.items()):
                raise ValueError(
                    f'{folder}: {raw_run.file_name(case.case)} was made from another content or '
                    f'with another tool than {case.path} asks for; name another folder'
                )
    return [c for c in cases if (c.case if isinstance(c, Recording) else c) not in done]


def _generate(scene, cases, output_path, settings, num_processes, show_progress) -> list[dict]:
    finished = raw_run.finished_runs(
        output_path,
        scene,
        settings.recorded() | {'solver_version': versions.SOLVER_VERSION},
    )
    todo = _unfinished(scene, cases, finished, output_path)
    if not todo:
        return []
    packed = _packed(scene, settings, output_path)
    shared = (scene, packed, settings, output_path)
    new, failures = [], []

    def note(case, simulate) -> None:
        """Adds a finished run to the manifest, or the reason why there is none to the failures."""
        try:
            new.append(simulate())
        except ValueError as error:
            failures.append(f'{_name(scene, case)}: {error}')
        else:
            raw_run.write_manifest(output_path, scene, finished + new)

    if num_processes == 1 or len(todo) == 1:
        for number, case in enumerate(todo):
            with tqdm(
                total=motion_of(scene, case).simulated_frames,
                desc=f'{_name(scene, case)} ({number + 1} of {len(todo)})',
                unit='frame',
                disable=not show_progress,
                mininterval=1.0,
            ) as bar:

                def show(frame, bar=bar):
                    bar.update(frame - bar.n)

                note(case, lambda case=case, show=show: _simulate(shared, case, show))
    else:
        _in_processes(
            (scene, settings, output_path), todo, min(num_processes, len(todo)), note, show_progress
        )
    if failures:
        raise ValueError(
            f'{len(failures)} of {len(todo)} runs failed, {len(new)} were made and are kept in '
            f'{output_path}:\n  ' + '\n  '.join(failures)
        )
    return new


def _in_processes(folder, todo, num_processes, note, show_progress) -> None:
    """Simulates the cases in processes of their own; `note` takes each as it is finished."""
    context = multiprocessing.get_context('spawn')
    pool = concurrent.futures.ProcessPoolExecutor(num_processes, context, _keep, folder)
    try:
        futures = {pool.submit(_simulate_kept, case): case for case in todo}
        with tqdm(
            total=len(todo), desc=folder[0].name, unit='run', disable=not show_progress
        ) as bar:
            for future in concurrent.futures.as_completed(futures):
                note(futures[future], future.result)
                bar.update()
    except BrokenProcessPool as error:
        raise OSError(
            'a process was killed from outside (out of memory?); finished runs are kept, the same '
            'command goes on'
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _packed(scene, settings, folder) -> tuple:
    """Returns the packing of a folder of raw runs, made if it is absent."""
    soil = make_soil(settings.youngs_modulus, scenes.PACKING_MU_S)
    return packing.settled(scene.bin, soil, settings.seed, folder)


# What all runs of a process of the pool share; see `_simulate`.
_kept: tuple | None = None


def _keep(scene, settings, output_path) -> None:
    global _kept
    parent.end_with_parent()
    _kept = (scene, _packed(scene, settings, output_path), settings, output_path)


def _simulate_kept(case) -> dict:
    return _simulate(_kept, case)


def _simulate(shared: tuple, case, on_frame=None) -> dict:
    """Simulates and writes one run; returns its entry of the manifest.

    Args:
        shared: scene, packing, settings, folder.
        case: what to run.
        on_frame: see `run.run_case`.
    """
    scene, packed, settings, output_path = shared
    return raw_run.write_run(output_path, run.run_case(scene, case, packed, settings, on_frame))
