"""How much of a model's error is chance: the same runs in a bed whose grains lie otherwise.

All runs of the data of record begin with one packing (`mpm/packing.py`), so a model may learn that
packing too. Runs of the same cases with another seed tell how far two solutions of one case are
apart, and whether a shipped field is further from a packing that it has not seen. Two solutions
differ by sqrt(2) times the error that even a perfect model has, which cannot know the packing.

Examples:
    python -m mpm.generate --scene=wheel --seed=1 --cases=11,slip_0004 --output_path=raw
    lts convert --raw_path=raw --like=datasets/wheel --output_path=wheel_packing
    python -m reports packing --data_path=excavation_packing,wheel_packing \\
        --output_path=docs/packing.json
"""

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
WHO = {
    'packings': 'one packing from the other',
    'usual': 'model, packing of training',
    'other': 'model, the other packing',
}


def judged(tool: str, others: list[runs_lib.Run]) -> list[dict]:
    """Errors of each run with another packing, and of the field of a tool in both; ValueError: the
    data of record do not hold a case."""
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
        apart = evaluation.load_errors(run, other.force[H:], other.torque[H:])
        apart |= evaluation.terrain_errors(run, other.heights)
        row: dict = {'case': run.case, 'kind': run.kind, 'split': run.split}
        for who, errors in (
            ('packings', apart),
            ('usual', evaluation.of_rollout(judges.roll_out(run), run)),
            ('other', evaluation.of_rollout(judges.roll_out(other), other)),
        ):
            row[who] = {key: record.four(errors[key]) for key in QUANTITIES}
        rows.append(row)
    return rows


def table(path: str) -> str:
    """Means over the runs, medians of parts of a load."""
    rows = []
    for tool, runs in files.read_json(path)['tools'].items():
        for who, name in WHO.items():
            cells = [average(key, [run[who][key] for run in runs]) for key in QUANTITIES]
            rows.append([f'{tool} ({len(runs)} runs): {name}', *cells])
    return markdown.table(['difference', *(TITLES[key] for key in QUANTITIES)], rows)


def main(values) -> None:
    others: dict[str, list] = {}
    for split in SPLITS:
        for run in runs_lib.read_all(values.data_path, split, is_needed=False):
            others.setdefault(run.tool.name, []).append(run)
    found: dict = record.provenance(1)
    found['tools'] = {tool: judged(tool, others[tool]) for tool in SCENES if tool in others}
    files.write_json(values.output_path, found)
    print(table(values.output_path))


def define_flags() -> None:
    flags.DEFINE_list('data_path', None, 'Datasets of runs with another packing.', required=True)
    flags.DEFINE_string('output_path', None, 'JSON file to write.', required=True)
