"""Simulates runs of a scene and writes them as raw runs.

Examples:
    python -m mpm.generate --scene=excavation --cases=mini --output_path=/tmp/raw/excavation
    python -m mpm.generate --scene=wheel --cases=122 --output_path=/tmp/raw/wheel
    python -m mpm.generate --scene=excavation --cases=full --num_processes=16 --output_path=DIR

    # paths of an operator (kinds take turns), free drives of the wheel; nobody has seen these seeds
    python -m mpm.generate --scene=excavation --operator_seeds=9000-9009 --output_path=/tmp/raw/new
    python -m mpm.generate --scene=excavation --operator_seeds=9000-9005 --kinds=beside,press \\
        --output_path=/tmp/raw/machines
    python -m mpm.generate --scene=wheel --operator_seeds=9000-9009 --kinds=stops,reverse \\
        --output_path=/tmp/raw/new_wheel

    # a path of your own: time_s, x_m, y_m, angle_deg (see mpm/motions/recording.py); a tool of your
    # own (see mpm/bodies.py) in a soil of your own
    python -m mpm.generate --scene=excavation --path=mine.csv --output_path=/tmp/raw/mine
    python -m mpm.generate --scene=excavation --operator_seeds=0-9 --tool=bucket.json \\
        --friction_angle_deg=33 --output_path=/tmp/raw/bucket

    # on machines of a cluster, by Dask
    python -m mpm.generate --scene=wheel --cases=full --cluster=slurm:64 --output_path=/shared/raw

A folder belongs to one scene and one packing; kinds that need another bin (beside, tools: twice as
wide; trench: 2 m long) go into a folder inside, `wide` or `long`. A command that was interrupted
goes on where it stopped when it is given again.

All runs start from the same settled packing, which is made once and
kept in the folder. All motions are checked against floor, walls and time step before the first run.
`python -m mpm.record` makes the whole data of record.
"""

import sys
import time

from absl import app, flags, logging

from mpm import bodies, scenes
from mpm.batch import generate
from mpm.motions import catalogue
from mpm.motions.recording import Recording
from mpm.simulation import Settings

_SCENE = flags.DEFINE_enum('scene', None, sorted(scenes.SCENES), 'Which scene.', required=True)
_CASES = flags.DEFINE_string(
    'cases',
    None,
    "Cases of the grid: 'mini' (40 spread over it, if nothing else is named), 'full', or numbers: "
    '44,122.',
)
_OPERATOR_SEEDS = flags.DEFINE_string(
    'operator_seeds',
    None,
    'Seeds of paths that an operator drives (excavation) or of free drives (wheel): 9000-9009.',
)
_KINDS = flags.DEFINE_string(
    'kinds',
    None,
    'Kinds of these paths; a seed s has the kind number s modulo their count. There are '
    + '; '.join(f'{name}: {",".join(kinds)}' for name, kinds in catalogue.KINDS.items())
    + '. Without the flag those take turns that drive the usual tool in the usual soil.',
)
_PATH = flags.DEFINE_list('path', [], 'CSV files of paths: time_s, x_m, y_m, angle_deg [, load_N].')
_BLADE_WIDTH = flags.DEFINE_float(
    'blade_width', bodies.BLADE_WIDTH, 'Width of the blade on the paths of files, m.'
)
_LIKE_CASE = flags.DEFINE_integer(
    'like_case',
    scenes.WHEEL.demo_case,
    'Case of the wheel grid whose soil, gravity, wheel and load the paths of files have.',
)
_OUTPUT_PATH = flags.DEFINE_string('output_path', None, 'Folder of the raw runs.', required=True)
_NUM_PROCESSES = flags.DEFINE_integer(
    'num_processes', 1, 'Runs at a time, one core each.', lower_bound=1
)
_YOUNGS_MODULUS = flags.DEFINE_float(
    'youngs_modulus', 1.5e6, 'Stiffness of the soil, Pa. The cost grows with its root.'
)
_TOOL = flags.DEFINE_string('tool', None, 'JSON file of a tool for all runs (mpm/bodies.py).')
_FRICTION_ANGLE = flags.DEFINE_float(
    'friction_angle_deg', None, 'Of the soil, 15 to 50 deg; default: what each run has.'
)
_BULK_DENSITY = flags.DEFINE_float('bulk_density', None, 'Of the packed soil, kg/m3; likewise.')
_GRAVITY = flags.DEFINE_float('gravity', None, 'm/s2; likewise.')
_TOOL_FRICTION = flags.DEFINE_float('tool_friction', None, 'Of soil on the tool; likewise.')
_CLUSTER = flags.DEFINE_string(
    'cluster', '', 'Where runs are made: local:4, slurm:64, tcp://host:port; empty: processes here.'
)
_SEED = flags.DEFINE_integer('seed', 0, 'Seed of the initial packing.')


def chosen_runs(scene: scenes.Scene) -> tuple:
    """Returns what the flags name: cases, ids of seeds, recordings.

    Raises:
        ValueError: see `scenes.select_cases` and `catalogue.select_seeds`.
    """
    runs: tuple = ()
    if _OPERATOR_SEEDS.value is not None:
        runs += catalogue.select_seeds(scene, _OPERATOR_SEEDS.value, _KINDS.value)
    elif _KINDS.value is not None:
        raise ValueError('--kinds chooses among paths of seeds; give --operator_seeds, too')
    runs += tuple(Recording(path, _LIKE_CASE.value, _BLADE_WIDTH.value) for path in _PATH.value)
    if _CASES.value is not None or not runs:
        runs = scenes.select_cases(scene, _CASES.value or 'mini') + runs
    return runs


def main(argv):
    if len(argv) > 1:
        raise app.UsageError(f'unknown arguments: {argv[1:]}')
    started = time.time()
    try:
        scene = scenes.scene_named(_SCENE.value)
        runs = chosen_runs(scene)
        settings = Settings(
            _YOUNGS_MODULUS.value,
            _SEED.value,
            _FRICTION_ANGLE.value,
            _BULK_DENSITY.value,
            _GRAVITY.value,
            _TOOL_FRICTION.value,
        )
        tool = None if _TOOL.value is None else bodies.read_tool(_TOOL.value)
        new = generate(
            scene, runs, _OUTPUT_PATH.value, settings, _NUM_PROCESSES.value, tool, _CLUSTER.value
        )
    except (ValueError, OSError, ModuleNotFoundError) as error:
        logging.error('%s', error)
        sys.exit(1)
    cpu = [entry['parameters']['solver_cpu_s'] for entry in new]
    print(
        f'{scene.name}: {len(new)} runs simulated, {len(runs) - len(new)} were there already, '
        f'in {_OUTPUT_PATH.value}; {time.time() - started:.0f} s'
        + (f', {sum(cpu) / len(cpu):.1f} s of CPU a run' if cpu else '')
    )


if __name__ == '__main__':
    app.run(main)
