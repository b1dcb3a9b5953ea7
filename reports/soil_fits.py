"""How well `lts fit-soil` finds known soils: runs of the solver, and a published wheel.

calibration: each valid run of an operator or in a soil of its own (kinds `soils` and `brief`, these
with a tool of their own, too) alone, with its density given and without. The errors found here set
`fit_soil.OFF`; runs of training would flatter the model.
single: each test run of these two kinds, whose soil no other run has. three: all sets of three test
runs of an operator in the usual soil. So no run that judges has told what a spread is. unseen soil:
all runs of a dataset of `--fresh`, three paths in one soil, whose seeds nobody has seen.
wheel: the smooth wheel of Ding et al. (2011), J. Terramechanics 48, 27 (as digitised in
roverdevkit, MIT), one run per slip that rolls at its published sinkage with its published drawbar
and load.

Examples:
    for soil in '31 1450' '36 1700' '41 1560'; do set -- $soil
        lts generate --scene=excavation --operator_seeds=9100-9102 --kinds=smooth,reverse,lift \
            --friction_angle_deg=$1 --bulk_density=$2 --output_path=raw/soil$1
        lts convert --raw_path=raw/soil$1 --like=datasets/excavation --output_path=soil$1
    done
    python -m reports soil_fits --fresh=soil31,soil36,soil41 --output_path=docs/soil_fits.json
    python -m reports documents docs/guide.md     # the table again, from the JSON
"""

import itertools
import os

import numpy as np
import tqdm
from absl import flags

from learning_to_simulate import command
from learning_to_simulate.soil_field import fit_soil
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Wheel
from pca_tools import dataset, files
from reports import markdown, record

DATA = 'datasets/excavation', 'datasets/excavation_more'
SOILS = 'soils', 'brief'
OPERATOR = ('smooth', 'stops', 'reverse', 'lift', 'disturbed', 'halts')
KINDS = ('calibration', 'single', 'three')
# Slip, drawbar N, sinkage m; load N, friction angle and density of the sand (cohesion 0.25 kPa).
DING = ((0.1, 11.0, 0.0055), (0.2, 14.5, 0.0075), (0.3, 15.0, 0.01), (0.4, 15.0, 0.0125),
        (0.6, 15.0, 0.0175))  # fmt: skip
DING_LOAD, DING_SOIL = 80.0, (31.9, 1605.0)
RIM_SPEED, FRAMES, STEADY = 0.04, 180, 60


def entry(name: str, true: tuple[float, float], found) -> dict:
    """What is kept of a fit: true and found angle (deg) and density (kg/m3), spreads, reasons."""
    return {
        'name': name, 'true_angle_deg': true[0], 'true_density': true[1],
        'angle_deg': found.angle_deg, 'angle_spread_deg': found.angle_spread_deg,
        'density': found.density, 'density_spread': found.density_spread,
        'correlation': found.correlation, 'trade_percent': found.trade_percent,
        'misfit': found.misfit, 'reasons': list(found.reasons),
    }  # fmt: skip


def summary(entries: list[dict]) -> dict:
    """Of fits with a number: root mean square and largest error of the angle (deg), share within 2
    deg and within two spreads, mean and spread of the density over the true one."""
    told = [row for row in entries if row['angle_deg'] is not None]
    if not told:
        return {'fits': len(entries), 'told': 0}
    off = np.array([row['angle_deg'] - row['true_angle_deg'] for row in told])
    spread = np.array([row['angle_spread_deg'] for row in told])
    ratio = np.array([row['density'] / row['true_density'] for row in told])
    return {
        'fits': len(entries), 'told': len(told), 'angle_rms_deg': float(np.sqrt(np.mean(off**2))),
        'angle_bias_deg': float(off.mean()), 'angle_worst_deg': float(np.abs(off).max()),
        'within_2_deg': float(np.mean(np.abs(off) <= 2.0)),
        'within_2_spreads': float(np.mean(np.abs(off) <= 2.0 * spread)),
        'density_ratio': float(ratio.mean()), 'density_ratio_spread': float(ratio.std()),
        'density_rms': float(np.sqrt(np.mean((ratio - 1) ** 2))),
    }  # fmt: skip


def known_soils(field) -> dict[str, list[dict]]:
    """Fits of runs of the data of record: those that calibrate, and those that judge."""
    from learning_to_simulate.soil_field import digs

    cases: dict[tuple[str, str], dict] = {}
    for folder in DATA:
        for split, of in dataset.read_metadata(folder)['cases'].items():
            cases |= {(split, str(case['case'])): case for case in of}
    true = {n: (c['friction_angle_deg'], c['bulk_density_kg_m3']) for (_, n), c in cases.items()}
    soils, usual = (
        {split: [n for (of, n), c in cases.items() if of == split and c['kind'] in kinds]
         for split in ('valid', 'test')}
        for kinds in (SOILS, OPERATOR)
    )  # fmt: skip
    sets: list[tuple[str, tuple]] = [
        *(('calibration', (n,)) for n in soils['valid'] + usual['valid']),
        *(('single', (n,)) for n in soils['test']),
        *(('three', three) for three in itertools.combinations(usual['test'], 3)),
    ]
    runs = digs.of_dataset(','.join(DATA), sorted({n for _, of in sets for n in of}))
    rolled = {
        dig.name: fit_soil.Rolled(field, dig)
        for dig in tqdm.tqdm(runs, unit='run', disable=None)
    }  # fmt: skip
    found: dict[str, list[dict]] = {
        kind + what: [] for kind in KINDS for what in ('', ', density given')
    }
    for kind, names in sets:
        for given, what in ((None, ''), (true[names[0]][1], ', density given')):
            fit = fit_soil.fit([rolled[n] for n in names], given)
            found[kind + what].append(entry(' '.join(names), true[names[0]], fit))
    return found


def unseen_soil(field, folder: str) -> dict[str, dict]:
    """Fits of all runs of a dataset at once, which share a soil (ValueError)."""
    from learning_to_simulate.soil_field import digs

    cases = [case for of in dataset.read_metadata(folder)['cases'].values() for case in of]
    soils = {(case['friction_angle_deg'], case['bulk_density_kg_m3']) for case in cases}
    if len(soils) != 1:
        raise ValueError(f'{folder}: runs of one soil were expected, found {sorted(soils)}')
    names, (true,) = [str(case['case']) for case in cases], soils
    rolled = [fit_soil.Rolled(field, dig) for dig in digs.of_dataset(folder, names)]
    name = f'{os.path.basename(folder)}: {" ".join(names)}'
    return {
        what: entry(name, true, fit_soil.fit(rolled, given))
        for given, what in ((None, ''), (true[1], ', density given'))
    }


def ding(field) -> list[dict]:
    """Fits of the published wheel, with its density given and without, of each slip and of all."""
    from learning_to_simulate.soil_field.digs import Dig

    wheel, times = Wheel(width=0.165, radius=0.15735), np.arange(FRAMES) / 60.0
    down = np.clip(times / 0.5, 0.0, 1.0)
    digs = []
    for slip, drawbar, sinkage in DING:
        pose, force = np.zeros((FRAMES, 7)), np.full((FRAMES, 3), np.nan)
        turned = RIM_SPEED * np.maximum(times - 0.5, 0.0)
        pose[:, 0] = -(1 - slip) * turned
        pose[:, 1] = wheel.radius + 0.002 - down * (sinkage + 0.002)
        half = turned / wheel.radius / 2
        pose[:, 3], pose[:, 6] = np.cos(half), np.sin(half)
        force[-STEADY:, :2] = -drawbar, DING_LOAD
        ground = Terrain.flat((2.0, 1.0), corner=(-1.2, -0.5))
        digs.append(Dig(f'slip {slip}', wheel, ground, times, pose, force))
    rolled = [fit_soil.Rolled(field, dig) for dig in digs]
    sets = [[r] for r in rolled] + [rolled]
    return [
        entry(' '.join(r.dig.name for r in some), DING_SOIL, fit_soil.fit(some, given))
        for some in sets for given in (None, DING_SOIL[1])
    ]  # fmt: skip


def table(path: str) -> str:
    """The summary of the JSON as a table."""
    rows = []
    for name, found in files.read_json(path)['summary'].items():
        cells: tuple = ('', '', '')
        if found['told']:
            cells = (
                found['angle_rms_deg'], found['angle_worst_deg'],
                f'{found["density_ratio"]:.2f} ({found["density_ratio_spread"]:.2f})',
            )  # fmt: skip
        rows.append((name, f'{found["told"]} of {found["fits"]}', *cells))
    header = ('digs', 'told', 'angle off, RMS deg', 'worst', 'density over the true one (spread)')
    return markdown.table(header, rows)


def define_flags() -> None:
    flags.DEFINE_string('output_path', None, 'JSON file to write.', required=True)
    flags.DEFINE_list('fresh', [], 'Folders of datasets, three digs in one soil each.')


def main(values) -> None:
    command.writable_folder(str(values.output_path.rpartition('/')[0] or '.'))
    command.import_tensorflow(1)
    from learning_to_simulate.soil_field import method

    field = method.load('models/excavation/soil_field')
    fits = known_soils(field)
    for folder in values.fresh:
        for what, row in unseen_soil(field, folder).items():
            fits.setdefault('unseen soil' + what, []).append(row)
    fits['wheel of Ding'] = ding(method.load('models/wheel/soil_field'))
    made: dict = record.provenance(1)
    made |= {'summary': {name: summary(rows) for name, rows in fits.items()}}
    kept = {name: rows for name, rows in fits.items() if not name.startswith('three')}
    files.write_json(values.output_path, made | {'fits': kept})
    for name, row in made['summary'].items():
        print(name, {k: round(v, 3) for k, v in row.items()})
