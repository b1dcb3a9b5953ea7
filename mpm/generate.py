"""Simulates cases of a scene and writes them as raw runs.

Examples:
    python -m mpm.generate --scene=excavation --cases=mini --output_path=/tmp/raw/excavation
    python -m mpm.generate --scene=wheel --cases=122 --output_path=/tmp/raw/wheel
    python -m mpm.generate --scene=excavation --cases=full --num_processes=16 --output_path=DIR

A folder belongs to one scene and one packing. A command that was interrupted goes on where it
stopped when it is given again. All runs start from the same settled packing, which is made once and
kept in the folder.
"""

import multiprocessing
import os
import sys
import time

from absl import app, flags, logging
from tqdm import tqdm

from mpm import packing, raw_run, scenes
from mpm.constitutive import make_soil
from mpm.run import RHEOLOGIES, Settings, run_case

_SCENE = flags.DEFINE_enum('scene', None, sorted(scenes.SCENES), 'Which scene.', required=True)
_CASES = flags.DEFINE_string(
    'cases', 'mini', "'mini' (40 cases spread over the grid), 'full', or numbers: 44,122."
)
_OUTPUT_PATH = flags.DEFINE_string('output_path', None, 'Folder of the raw runs.', required=True)
_NUM_PROCESSES = flags.DEFINE_integer(
    'num_processes', 1, 'Runs at a time, one core each.', lower_bound=1
)
_YOUNGS_MODULUS = flags.DEFINE_float(
    'youngs_modulus', 1.5e6, 'Stiffness of the soil, Pa. The cost grows with its root.'
)
_RHEOLOGY = flags.DEFINE_enum(
    'rheology', 'local', RHEOLOGIES, 'Local mu(I), or nonlocal granular fluidity.'
)
_SEED = flags.DEFINE_integer('seed', 0, 'Seed of the initial packing.')


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
        ValueError: if the folder holds another scene or other settings, or a run fails.
    """
    os.makedirs(output_path, exist_ok=True)
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
        scene.bin, make_soil(settings.youngs_modulus, scenes.PACKING_MU_S), settings.seed,
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


def main(argv):
    if len(argv) > 1:
        raise app.UsageError(f'unknown arguments: {argv[1:]}')
    started = time.time()
    try:
        scene = scenes.scene_named(_SCENE.value)
        cases = scenes.select_cases(scene, _CASES.value)
        settings = Settings(_YOUNGS_MODULUS.value, _RHEOLOGY.value, _SEED.value)
        new = generate(scene, cases, _OUTPUT_PATH.value, settings, _NUM_PROCESSES.value)
    except ValueError as error:
        logging.error('%s', error)
        sys.exit(1)
    cpu = [entry['parameters']['solver_cpu_s'] for entry in new]
    print(
        f'{scene.name}: {len(new)} runs simulated, {len(cases) - len(new)} were there already, '
        f'in {_OUTPUT_PATH.value}; {time.time() - started:.0f} s'
        + (f', {sum(cpu) / len(cpu):.1f} s of CPU a run' if cpu else '')
    )


if __name__ == '__main__':
    app.run(main)
