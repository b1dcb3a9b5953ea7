"""Simulates runs of a scene and writes them as raw runs.

Examples:
    lts generate --scene=excavation --cases=mini --output_path=/tmp/raw/excavation
    lts generate --scene=wheel --cases=122,slip_0003 --output_path=/tmp/raw/wheel
    lts generate --scene=excavation --cases=full --num_processes=16 --output_path=DIR

    # paths of an operator (kinds take turns), free drives of the wheel; nobody has seen these seeds
    lts generate --scene=excavation --operator_seeds=9000-9009 --output_path=/tmp/raw/new
    lts generate --scene=excavation --operator_seeds=9000-9005 --kinds=beside,press \\
        --output_path=/tmp/raw/machines
    lts generate --scene=wheel --operator_seeds=9000-9009 --kinds=stops,reverse \\
        --output_path=/tmp/raw/new_wheel

    # a path of your own: time_s, x_m, y_m, angle_deg (see mpm/motions/recording.py); a tool of your
    # own (see mpm/bodies.py) in a soil of your own
    lts generate --scene=excavation --path=mine.csv --output_path=/tmp/raw/mine
    lts generate --scene=excavation --operator_seeds=0-9 --tool=bucket.json \\
        --friction_angle_deg=33 --output_path=/tmp/raw/bucket

    # on machines of a cluster, by Dask
    lts generate --scene=wheel --cases=full --cluster=slurm:64 --output_path=/shared/raw

A folder belongs to one scene and one packing; kinds that need another bin (beside, tools: twice as
wide; trench: 2 m long) go into a folder inside, `wide` or `long`. A command that was interrupted
goes on where it stopped when it is given again.

All runs start from the same settled packing, which is made once and kept in the folder. All motions
are checked against floor, walls and time step before the first run. `python -m mpm.record` makes
the whole data of record.
"""

import time

from absl import flags

from mpm import bodies, scenes
from mpm.motions import catalogue
from mpm.motions.recording import Recording
from pca_tools import command


def define_run_flags() -> None:
    """Defines the flags that choose runs, here and in `mpm.picture`."""
    kinds = '; '.join(f'{name}: {",".join(kinds)}' for name, kinds in catalogue.KINDS.items())
    flags.DEFINE_enum('scene', None, sorted(scenes.SCENES), 'Which scene.', required=True)
    flags.DEFINE_list(
        'cases', [], 'Numbers of cases of the grid and ids of seeds: 22,lift_0003; full: all '
        'cases; mini, or none of these flags: 40 cases spread over the grid.',
    )  # fmt: skip
    flags.DEFINE_string(
        'operator_seeds', None,
        'Seeds of paths that an operator drives (excavation) or of free drives (wheel): 9000-9009.',
    )  # fmt: skip
    flags.DEFINE_string(
        'kinds', None,
        'Kinds of these paths; a seed s has the kind number s modulo their count. There are '
        f'{kinds}. Without the flag those take turns that drive the usual tool in the usual soil.',
    )  # fmt: skip
    flags.DEFINE_list('path', [], 'CSV files of paths: time_s, x_m, y_m, angle_deg [, load_N].')
    flags.DEFINE_float(
        'blade_width', bodies.BLADE_WIDTH, 'Width of the blade on the paths of files, m.'
    )
    flags.DEFINE_integer(
        'like_case', scenes.WHEEL.demo_case,
        'Case of the wheel grid whose soil, gravity, wheel and load the paths of files have.',
    )  # fmt: skip
    flags.DEFINE_string('tool', None, 'JSON file of a tool for all runs (mpm/bodies.py).')


def chosen_runs(values) -> tuple[scenes.Scene, tuple, dict | None]:
    """Returns the scene that the flags name, its runs (cases, ids of seeds, recordings), the tool;
    ValueError as `catalogue.select_runs`, `catalogue.select_seeds` and `bodies.read_tool`."""
    scene, runs = scenes.SCENES[values.scene], ()
    if values.cases:
        runs = catalogue.select_runs(scene, values.cases)
    if values.operator_seeds is not None:
        runs += catalogue.select_seeds(scene, values.operator_seeds, values.kinds)
    elif values.kinds is not None:
        raise ValueError('--kinds chooses among paths of seeds; give --operator_seeds, too')
    runs += tuple(Recording(path, values.like_case, values.blade_width) for path in values.path)
    return scene, runs, None if values.tool is None else bodies.read_tool(values.tool)


def define_flags() -> None:
    define_run_flags()
    define_place_flags()
    flags.mark_flag_as_required('output_path')
    flags.DEFINE_float(
        'youngs_modulus', 1.5e6, 'Stiffness of the soil, Pa. The cost grows with its root.'
    )
    flags.DEFINE_float(
        'friction_angle_deg', None, 'Of the soil, 15 to 50 deg; default: what each run has.'
    )
    flags.DEFINE_float('bulk_density', None, 'Of the packed soil, kg/m3; the same.')
    flags.DEFINE_float('gravity', None, 'Acceleration, m/s2; the same.')
    flags.DEFINE_float('slope_deg', None, 'Of the ground on the way, -25 to 25 deg; the same.')
    flags.DEFINE_float('tool_friction', None, 'Coulomb coefficient of soil on the tool; the same.')
    flags.DEFINE_integer('seed', 0, 'Seed of the initial packing.')


def define_place_flags() -> None:
    """Defines where runs are made and kept, here and in `mpm.record`."""
    flags.DEFINE_string('output_path', None, 'Folder of the raw runs.')
    flags.DEFINE_integer('num_processes', 1, 'Runs at a time, one core each.', lower_bound=1)
    flags.DEFINE_string(
        'cluster', '',
        'Where runs are made: local:4, slurm:64, tcp://host:port; empty: processes here.',
    )  # fmt: skip


def main(values) -> None:
    from mpm.batch import generate  # help does not wait for Numba
    from mpm.simulation import Settings

    started = time.time()
    scene, runs, tool = chosen_runs(values)
    runs = runs or scene.mini
    names = ('youngs_modulus', 'seed', 'friction_angle_deg', 'bulk_density', 'gravity', 'slope_deg')
    settings = Settings(**{name: values[name].value for name in (*names, 'tool_friction')})
    how = settings, values.num_processes, tool, values.cluster
    new = generate(scene, runs, values.output_path, *how)
    cpu = [entry['parameters']['solver_cpu_s'] for entry in new]
    print(
        f'{scene.name}: {len(new)} runs simulated, {len(runs) - len(new)} were there already, '
        f'in {values.output_path}; {time.time() - started:.0f} s'
        + (f', {sum(cpu) / len(cpu):.1f} s of CPU a run' if cpu else '')
    )


if __name__ == '__main__':
    define_flags()
    command.start(main)
