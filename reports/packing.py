"""How much of a model's error is chance: the same runs with grains that lie otherwise.

All runs of the data of record begin with one packing (`mpm/packing.py`), so a model may learn that
packing too. Runs of the same cases with another seed tell how far two solutions of one case are
apart, and whether a shipped field is further from a packing that it has not seen. Runs whose grains
begin 1e-9 m elsewhere (moved in the file packing.npz of an empty folder of raw runs) tell how far
the same grains come apart. Two solutions differ by sqrt(2) times the error that even a perfect
model has.

Examples:
    python -m mpm.generate --scene=wheel --seed=1 --cases=11,slip_0004 --output_path=raw
    lts convert --raw_path=raw --like=datasets/wheel --output_path=wheel_packing
    python -m reports packing --data_path=excavation_packing,excavation_moved,wheel_packing \\
        --output_path=docs/packing.json
"""

import numpy as np
from absl import flags

import learning_to_simulate as lts
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.soil_field import runs as runs_lib
from pca_tools import files
from pca_tools.metadata import SPLITS
from reports import markdown, record
from reports.protocol.tables import TITLES, average

# Tool of a field -> its shipped model, and the datasets that hold its runs with the usual packing.
SCENES = {
    'blade': ('excavation', ('excavation', 'excavation_more', 'excavation_wide',
                             'excavation_long')),
    'wheel': ('wheel', ('wheel', 'wheel_more')),
}  # fmt: skip
QUANTITIES = 'near_mm', 'force_relative_l2', 'drawbar_relative_l2', 'pitch_relative_l2'
# Of a tool that its weight, load, springs and dampers move; of grains that begin at one place.
HEIGHT, SOIL = 'height_mm', 'soil_mm'
COLUMNS = SOIL, *QUANTITIES, HEIGHT
WHO = {'apart': 'the two runs', 'usual': 'model, run of record', 'other': 'model, the other run'}
MOVED = 1e-6  # m, less than which the grains of a packing were moved


def judged(tool: str, others: list[runs_lib.Run]) -> list[dict]:
    """How far each run, with another packing or grains that were moved, is from the one of record,
    and the errors of the field of a tool in both: a row a run, by `WHO` (mm; relative L2 norms).
    ValueError: the data of record do not hold a case."""
    from learning_to_simulate.soil_field import evaluation

    model, folders = SCENES[tool]
    judges = evaluation.SoilEvaluator(lts.load(model).model, under_load=False)
    paths = [f'datasets/{folder}' for folder in folders]
    usual = {
        run.case: run
        for split in sorted({run.split for run in others})
        for run in runs_lib.read_all(paths, split, is_needed=False)
    }
    if absent := [run.case for run in others if run.case not in usual]:
        raise ValueError(f'{", ".join(absent)}: no such run in datasets {", ".join(folders)}')
    rows = []
    for other in others:
        run = usual[other.case]
        is_free = run.machine is not None and run.machine.free[1]
        is_moved = _is_moved(run, other)
        apart = evaluation.load_errors(run, other.force[H:], other.torque[H:])
        apart |= evaluation.terrain_errors(run, other.heights)
        apart |= evaluation.motion_errors(other.pose, run) if is_free else {}
        apart |= evaluation.soil_errors(run, other.particles) if is_moved else {}
        row: dict = {'case': run.case, 'kind': run.kind, 'split': run.split, 'moved': is_moved}
        keys = *QUANTITIES, *[HEIGHT] * is_free, *[SOIL] * is_moved
        found = {'apart': apart}
        for who, of in (('usual', run), ('other', other)):
            found[who] = evaluation.of_rollout(judges.roll_out(of), of)
            if is_free:
                free = judges.roll_out(of, under_load=True)
                found[who] |= evaluation.motion_errors(free.pose, of)
        row |= {who: {key: record.four(of[key]) for key in keys} for who, of in found.items()}
        rows.append(row)
    return rows


def _is_moved(run, other) -> bool:
    """Whether most grains of two runs begin at one place, but for `MOVED`: an earlier pass may have
    moved the others."""
    if run.particles is None or run.particles.shape != other.particles.shape:
        return False
    return bool(np.median(np.abs(run.particles[0] - other.particles[0])) < MOVED)


def table(path: str) -> str:
    """Means over the runs, medians of parts of a load; heights of the tools that are free."""
    rows = []
    for tool, runs in files.read_json(path)['tools'].items():
        for is_moved, how in ((False, 'another packing'), (True, 'grains moved by 1 nm')):
            some = [run for run in runs if run['moved'] == is_moved]
            for who, name in WHO.items() if some else ():
                cells = []
                for key in COLUMNS:
                    errors = [run[who][key] for run in some if key in run[who]]
                    cells.append(average(key, errors) if errors else '')
                rows.append([f'{tool}, {how} ({len(some)} runs): {name}', *cells])
    return markdown.table(['difference', *(TITLES[key] for key in COLUMNS)], rows)


def main(values) -> None:
    others: dict[str, list] = {}
    for folder in values.data_path:
        for split in SPLITS:
            for run in runs_lib.read_all([folder], split, is_needed=False):
                others.setdefault(run.tool.name, []).append(run)
    found: dict = record.provenance(1)
    found['tools'] = {tool: judged(tool, others[tool]) for tool in SCENES if tool in others}
    files.write_json(values.output_path, found)
    print(table(values.output_path))


def define_flags() -> None:
    flags.DEFINE_list('data_path', None, 'Datasets of runs with another packing.', required=True)
    flags.DEFINE_string('output_path', None, 'JSON file to write.', required=True)
