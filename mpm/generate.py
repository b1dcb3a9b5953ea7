"""Simulates cases of a scene and writes them as raw runs.

Examples:
    python -m mpm.generate --scene=excavation --cases=mini --output_path=/tmp/raw/excavation
    python -m mpm.generate --scene=wheel --cases=122 --output_path=/tmp/raw/wheel
    python -m mpm.generate --scene=excavation --cases=full --num_processes=16 --output_path=DIR

A folder belongs to one scene and one packing. A command that was interrupted goes on where it
stopped when it is given again. All runs start from the same settled packing, which is made once and
kept in the folder.
"""

import sys
import time

from absl import app, flags, logging

from mpm import scenes
from mpm.batch import generate
from mpm.simulation import RHEOLOGIES, Settings

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


def main(argv):
    if len(argv) > 1:
        raise app.UsageError(f'unknown arguments: {argv[1:]}')
    started = time.time()
    try:
        scene = scenes.scene_named(_SCENE.value)
        cases = scenes.select_cases(scene, _CASES.value)
        settings = Settings(_YOUNGS_MODULUS.value, _RHEOLOGY.value, _SEED.value)
        new = generate(scene, cases, _OUTPUT_PATH.value, settings, _NUM_PROCESSES.value)
    except (ValueError, OSError) as error:
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
