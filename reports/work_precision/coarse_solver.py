"""The solver itself on coarser grids: work-precision points of the method that made the data.

Runs test runs with cells `factor` times as long, at the time step that these allow, on one thread,
and compares with the fine run over the frames that learned models predict: soil error in full
space on the particles that raw runs hold, force, and CPU seconds per simulated second. Where cells
grow so far that fewer particles fill them as well, every 5th (excavation) or 3rd (wheel) particle
is simulated (`mpm/coarse.py`). Unlike a learned model it is not given six true frames: it starts
from the same packing, and a wheel comes to rest on the coarse soil before it drives.

Examples:
    # one driven run of each kind, beside the methods of a protocol (`solver_rows.beside`)
    python -m reports coarse_solver --scene=excavation --grid_factors=1.5,2 --raw_path=/tmp/raw \\
        --cases=smooth_0000,lift_0003 --output_path=docs/coarse_solver_driven.json

    python -m reports coarse_solver --scene=excavation --cases=21,78 --grid_factors=1.5,2 \\
        --raw_path=/tmp/raw/excavation --output_path=docs/coarse_solver_excavation.json

    # without raw runs: the fine runs are made first, a minute each
    python -m reports coarse_solver --scene=wheel --cases=63 --grid_factors=2 \\
        --raw_path=/tmp/new --output_path=/tmp/coarse_wheel.json

The JSON has the form of a model's metrics.json: `mean` and `runs` by method (`solver`, the fine
run, which has a cost and no error; `solver_x2`, ...). A command that was interrupted goes on where
it stopped when it is given again.
"""

import os

import numpy as np
import tqdm
from absl import flags

from learning_to_simulate import metrics
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from mpm import batch, coarse, packing, raw_run, scenes
from mpm.constitutive import make_soil
from mpm.motions import catalogue
from mpm.run import make_simulation, run_case
from mpm.simulation import Settings
from pca_tools import files
from reports import command, markdown, record


def errors(run, fine) -> dict[str, float]:
    """Errors of one run against the fine one over the frames H .. T - 1."""
    position, truth = (x.positions[H:].astype(np.float64) for x in (run, fine))
    body, true_body = (x.rigid_positions[H:].astype(np.float64) for x in (run, fine))
    soil_mse = float(((position - truth) ** 2).mean())
    force = metrics.force_errors(*(x.force[None, H:].astype(np.float64) for x in (run, fine)))
    return {
        'soil_mse': soil_mse,
        'soil_rms_mm': float(metrics.rms_mm(soil_mse)),
        'rigid_mse': float(((body - true_body) ** 2).mean()),
        **{name: float(value[0]) for name, value in force.items()},
    }


def cost(run) -> dict[str, float]:
    """CPU time of a run, one thread, over the frames that it simulates, those of a lead-in too."""
    frames = len(run.positions) - 1 + run.parameters.get('lead_in_frames', 0)
    seconds = run.parameters['solver_cpu_s']
    return {
        'seconds_per_simulated_second': seconds * scenes.FRAME_RATE / frames,
        'milliseconds_per_step': 1e3 * seconds / frames,
    }


def measure_case(scene, case: int | str, factor: float, packed, fine, on_frame=None) -> dict:
    """Runs one case on a coarser grid; returns its row.

    Raises:
        ValueError: a factor or a case that the solver refuses, or a run that fails.
    """
    coarser = coarse.coarsened(scene, factor)
    thin = coarse.thinned(packed, coarser)
    settings = Settings(
        fine.parameters['youngs_modulus_Pa'],
        fine.parameters['rheology'],
        fine.parameters['seed'],
        dilation=fine.parameters.get('dilation', 0.0),
    )
    run = run_case(coarser, case, thin, settings, on_frame)
    if run.positions.shape != fine.positions.shape:
        raise ValueError(
            f'case {case}: the coarse run holds (frames, particles) {run.positions.shape[:2]}, '
            f'the fine one {fine.positions.shape[:2]}'
        )
    return {
        'record': case,
        'grid_factor': factor,
        'cell_size_m': coarser.bin.dx,
        'particles': len(thin[0]),
        'wall_gap_m': coarser.bin.wall_gap,
        'time_step_s': run.parameters['time_step_s'],
        'status': 'ok' if np.isfinite(run.positions).all() else 'non_finite',
        **errors(run, fine),
        **cost(run),
    }


def _warm_up() -> None:
    """Compiles the kernels, so that no run pays for it: one frame of loose soil."""
    scene = coarse.coarsened(scenes.EXCAVATION, 2.0)
    parameters = scene.parameters(scene.demo_case)
    soil = make_soil(Settings.youngs_modulus, scenes.static_friction(scene, parameters))
    particles, _ = coarse.thinned((packing.lattice(scene.bin, 0), {}), scene)
    make_simulation(scene, parameters, soil, particles, Settings()).frame()


def _means(runs: dict[str, list[dict]]) -> dict[str, dict[str, float]]:
    keys = ('soil_mse', 'rigid_mse', 'force_', 'soil_rms', 'seconds_per', 'milliseconds_per')
    mean = {}
    for method, rows in runs.items():
        names = [k for k in rows[0] if k.startswith(keys)]
        mean[method] = {k: float(np.mean([row[k] for row in rows])) for k in names}
        if 'force_mpe' in mean[method]:
            mean[method]['force_abs_mpe'] = float(np.mean([abs(row['force_mpe']) for row in rows]))
    return mean


def measure(scene, cases, factors, raw_path: str, output_path: str) -> dict:
    """Measures all cases at all factors, and writes the JSON after each.

    Raises:
        ValueError: bad factors, raw runs of another scene, or an output file of something else.
    """
    for factor in factors:
        coarse.coarsened(scene, factor)
    identity = {'scene': scene.name, 'reference': 'fine run, full space'}
    summary = record.resume(output_path, identity, {'mean': {}, 'runs': {}})
    # Absent fine runs are made; those that are there are kept as they are.
    batch.generate(scene, cases, raw_path, Settings())
    packed = packing.settled(
        scene.bin, make_soil(Settings.youngs_modulus, scenes.PACKING_MU_S), Settings.seed, raw_path
    )
    warm = False
    for case in cases:
        fine = raw_run.read_run(os.path.join(raw_path, raw_run.file_name(case)))
        for factor in (None, *factors):
            method = 'solver' if factor is None else f'solver_x{factor:g}'
            done = summary['runs'].setdefault(method, [])
            if any(row['record'] == case for row in done):
                continue
            if factor is None:
                done.append({'record': case, 'status': 'ok', **cost(fine)})
            else:
                if not warm:
                    _warm_up()
                    warm = True
                done.append(_row_with_bar(scene, case, factor, packed, fine))
            summary |= record.provenance(1)
            summary['mean'] = _means({k: v for k, v in summary['runs'].items() if v})
            files.write_json(output_path, summary)
    return summary


def _row_with_bar(scene, case, factor, packed, fine):
    with tqdm.tqdm(
        total=catalogue.motion_of(scene, case).simulated_frames,
        desc=f'{scene.name} case {case} on cells x {factor:g}',
        unit='frame',
        disable=None,
        mininterval=1.0,
    ) as bar:
        return measure_case(scene, case, factor, packed, fine, lambda n: bar.update(n - bar.n))


def table(summary: dict) -> str:
    """The means as text, one row per method."""
    rows = []
    for method, mean in summary['mean'].items():
        soil = mean.get('soil_mse')
        rows.append(
            (method, len(summary['runs'][method]), soil and float(metrics.rms_mm(soil)),
             mean.get('force_relative_l2'), mean['seconds_per_simulated_second'])
        )  # fmt: skip
    header = ('method', 'runs', 'soil RMS mm', 'force rel. L2', 'CPU s per simulated s')
    return markdown.table(header, rows, aligned=True)


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_enum('scene', None, sorted(scenes.SCENES), 'Which scene.', required=True)
    flags.DEFINE_list(
        'cases', None, 'Cases of the grid, and driven runs such as lift_0003.', required=True
    )
    flags.DEFINE_list('grid_factors', ['1.5', '2'], 'Cell sizes over the fine one.')
    flags.DEFINE_string(
        'raw_path', None, 'Folder of fine raw runs; absent ones are made.', required=True
    )
    flags.DEFINE_string('output_path', None, 'JSON file of the rows.', required=True)


def main(values, _) -> None:
    """Runs the command."""
    scene = scenes.scene_named(values.scene)
    cases = catalogue.select_runs(scene, values.cases)
    factors = [float(factor) for factor in values.grid_factors]
    summary = measure(scene, cases, factors, values.raw_path, values.output_path)
    print(table(summary))
    print(f'wrote {values.output_path}')


if __name__ == '__main__':
    command.start(define_flags, main)
