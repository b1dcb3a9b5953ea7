"""Many runs of a scene into one folder: a pool of processes, a manifest, resuming."""

import multiprocessing
import os

from tqdm import tqdm

from mpm import packing, raw_run, scenes
from mpm.constitutive import make_soil
from mpm.files import one_writer
from mpm.run import run_case
from mpm.simulation import Settings


def generate(
    scene: scenes.Scene,
    cases: tuple,
    output_path: str,
    settings: Settings,
    num_processes: int = 1,
    show_progress: bool = True,
) -> list[dict]:
    """Simulates the cases that a folder does not hold yet.

    Args:
        scene: the scene.
        cases: case numbers.
        output_path: folder, made if absent.
        settings: of all runs in the folder.
        num_processes: runs at a time.
        show_progress: whether to draw bars.

    Returns:
        The manifest entries of the new runs.

    Raises:
        ValueError: if the folder holds another scene or other settings, another process writes into
            it, or a run fails.
    """
    os.makedirs(output_path, exist_ok=True)
    with one_writer(output_path):
        return _generate(scene, cases, output_path, settings, num_processes, show_progress)


def _generate(scene, cases, output_path, settings, num_processes, show_progress) -> list[dict]:
    finished = raw_run.finished_runs(
        output_path,
        scene,
        {
            'youngs_modulus_Pa': settings.youngs_modulus,
            'rheology': settings.rheology,
            'seed': settings.seed,
        },
    )
    done = {entry['case'] for entry in finished}
    todo = [case for case in cases if case not in done]
    new = []
    if not todo:
        return new
    packed = packing.settled(
        scene.bin,
        make_soil(settings.youngs_modulus, scenes.PACKING_MU_S),
        settings.seed,
        output_path,
    )
    jobs = [(scene, case, packed, settings, output_path) for case in todo]

    def note(entry):
        new.append(entry)
        raw_run.write_manifest(output_path, scene, finished + new)

    if num_processes == 1 or len(todo) == 1:
        for number, job in enumerate(jobs):
            with tqdm(
                total=scenes.FRAMES - 1,
                desc=f'{scene.name} case {job[1]} ({number + 1} of {len(jobs)})',
                unit='frame',
                disable=not show_progress,
                mininterval=1.0,
            ) as bar:
                note(_simulate(job, lambda frame, bar=bar: bar.update(frame - bar.n)))
        return new
    with (
        multiprocessing.get_context('spawn').Pool(min(num_processes, len(jobs))) as pool,
        tqdm(total=len(jobs), desc=scene.name, unit='run', disable=not show_progress) as bar,
    ):
        for entry in pool.imap_unordered(_simulate, jobs):
            note(entry)
            bar.update()
    return new


def _simulate(job, on_frame=None) -> dict:
    """Simulates and writes one case; returns its entry of the manifest."""
    scene, case, packed, settings, output_path = job
    try:
        run = run_case(scene, case, packed, settings, on_frame)
    except ValueError as error:
        raise ValueError(f'{scene.name} case {case}: {error}') from error
    return raw_run.write_run(output_path, run)
