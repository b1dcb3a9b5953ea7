"""Simulates runs of the solver on many processes or machines; files and folder as of mpm.generate.

One task per run, one whole file per run, so a command that was interrupted goes on where it stopped
when it is given again. The folder must be on a disk that all workers see. A worker that dies costs
its run's time; a run that fails three times is reported at the end, and the others are made.

Examples:
    python -m run_scripts.solver_on_cluster --scene=excavation --cases=mini --output_path=raw \\
        --cluster=local:8

    # 64 batch jobs; or a scheduler that runs already
    python -m run_scripts.solver_on_cluster --scene=wheel --cases=full --output_path=/shared/raw \\
        --cluster=slurm:64
    python -m run_scripts.solver_on_cluster --scene=wheel --cases=full --output_path=/shared/raw \\
        --cluster=tcp://10.0.0.1:8786

    # the script that slurm would be given
    python -m run_scripts.solver_on_cluster --job_script

    # without Dask: an array of jobs, each a share of the cases, then one call for the manifest
    sbatch --array=0-63 --wrap='python -m run_scripts.solver_on_cluster --scene=wheel \\
        --cases=full --output_path=/shared/raw --part=$SLURM_ARRAY_TASK_ID --parts=64'
    python -m run_scripts.solver_on_cluster --scene=wheel --cases=full --output_path=/shared/raw
"""

import os
import sys
from collections.abc import Sequence
from typing import Any

from absl import app, flags
from tqdm import tqdm

from cluster import workers
from mpm import files, packing, raw_run, run, scenes, versions
from mpm.constitutive import make_soil
from mpm.simulation import Settings
from storage import messages


def simulate(job: tuple) -> dict[str, Any]:
    """Makes one run, or returns the entry of the one that is there whole.

    Args:
        job: (scene name, case, settings, folder).

    Returns:
        Its entry of the manifest.
    """
    name, case, settings, folder = job
    scene = scenes.scene_named(name)
    path = os.path.join(folder, raw_run.file_name(case))
    if os.path.exists(path):
        return _entry_of(path, settings)
    soil = make_soil(settings.youngs_modulus, scenes.PACKING_MU_S)
    packed = packing.settled(scene.bin, soil, settings.seed, folder)
    return raw_run.write_run(folder, run.run_case(scene, case, packed, settings))


def _entry_of(path: str, settings: Settings) -> dict[str, Any]:
    """Returns the entry of a run that is there already: of a command that was killed, or a part."""
    held = raw_run.read_run(path)
    for name, value in _shared(settings).items():
        if held.parameters.get(name) != value:
            raise ValueError(
                f'{path}: was made with {name} = {held.parameters.get(name)!r}, not {value!r}; '
                'name another folder'
            )
    return {
        'file': os.path.basename(path),
        'case': held.parameters['case'],
        'bytes': os.path.getsize(path),
        'sha256': raw_run.digest(path),
        'content': raw_run.content_digest(held),
        'parameters': held.parameters,
    }


def _shared(settings: Settings) -> dict[str, Any]:
    """Returns the parameters that all runs of a folder share."""
    return settings.recorded() | {'solver_version': versions.SOLVER_VERSION}


def generate(
    scene: scenes.Scene,
    cases: Sequence,
    folder: str,
    settings: Settings,
    where: str,
    processes: int | None = None,
) -> tuple[list[dict[str, Any]], list[str]]:
    """Makes the runs that a folder does not hold yet.

    Args:
        scene: the scene.
        cases: case numbers, or names of operator paths.
        folder: of raw runs, seen by all workers.
        settings: of all of its runs.
        where: see `cluster.workers`.
        processes: of a pool.

    Returns:
        The manifest entries of the new runs, and why others failed.

    Raises:
        ValueError: the folder holds another scene or other settings, or another process writes it.
        OSError: the scheduler is gone, or the pool lost a process; finished runs are kept.
    """
    os.makedirs(folder, exist_ok=True)
    with files.one_writer(folder):
        finished = raw_run.finished_runs(folder, scene, _shared(settings))
        done = {entry['case'] for entry in finished}
        todo = [case for case in cases if case not in done]
        if not todo:
            return [], []
        # Made once, before the workers would all make it.
        packing.settled(
            scene.bin,
            make_soil(settings.youngs_modulus, scenes.PACKING_MU_S),
            settings.seed,
            folder,
        )
        jobs = [(scene.name, case, settings, folder) for case in todo]
        new: list[dict[str, Any]] = []
        failed: list[str] = []
        with (
            workers.start(where, processes) as crew,
            tqdm(total=len(jobs), desc=scene.name, unit='run') as bar,
        ):
            for outcome in crew.run(simulate, jobs):
                if outcome.error is None:
                    new.append(outcome.value)
                    raw_run.write_manifest(folder, scene, finished + new)
                else:
                    failed.append(f'{scene.name} {todo[outcome.index]}: {outcome.error}')
                bar.update()
    return new, failed


def define_flags() -> None:
    """Defines the flags; not at import, so that several commands can be imported together."""
    flags.DEFINE_enum('scene', None, sorted(scenes.SCENES), 'Which scene.')
    flags.DEFINE_string('cases', 'mini', "'mini', 'full', or numbers: 44,122.")
    flags.DEFINE_string('output_path', None, 'Folder of the raw runs, on a disk all workers see.')
    flags.DEFINE_string('cluster', '', "'' (a pool), local, local:4, slurm, slurm:64, tcp://...")
    flags.DEFINE_integer('num_processes', None, 'Of the pool; default one per core.')
    flags.DEFINE_integer('part', 0, 'Which share of the cases, of --parts.')
    flags.DEFINE_integer('parts', 1, 'Shares of the cases, one per job of an array.')
    flags.DEFINE_bool('job_script', False, 'Print what slurm would be given, and end.')


def main(_: Sequence[str]) -> None:
    """Runs the command."""
    values = flags.FLAGS
    try:
        if values.job_script:
            with workers.slurm_cluster() as batch:
                print(batch.job_script())
            return
        if not values.scene or not values.output_path:
            sys.exit('error: --scene and --output_path are needed')
        scene = scenes.scene_named(values.scene)
        cases = scenes.select_cases(scene, values.cases)
        if values.parts > 1:
            _simulate_part(values, cases)
            return
        new, failed = generate(
            scene, cases, values.output_path, Settings(), values.cluster, values.num_processes
        )
    except (ValueError, OSError, ModuleNotFoundError) as error:
        sys.exit(f'error: {messages.printable(error)}')
    print(f'{scene.name}: {len(new)} runs in {values.output_path}')
    for reason in failed:
        print(f'failed: {messages.printable(reason)}', file=sys.stderr)
    sys.exit(1 if failed else 0)


def _simulate_part(values, cases: Sequence) -> None:
    """The share of one job of an array: files only, the manifest is the last call's business."""
    if not 0 <= values.part < values.parts:
        raise ValueError(f'part is {values.part}, 0 to {values.parts - 1} was expected')
    os.makedirs(values.output_path, exist_ok=True)
    for case in tqdm(cases[values.part :: values.parts], desc=values.scene, unit='run'):
        simulate((values.scene, case, Settings(), values.output_path))


if __name__ == '__main__':
    define_flags()
    app.run(main)
