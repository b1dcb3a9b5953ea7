"""Checks of the solver with numbers, as a table.

Examples:
    python -m mpm.verify
    python -m mpm.verify --raw_path=/tmp/raw --json=verify.json

Runs that a check needs are read from RAW_PATH/excavation and RAW_PATH/wheel; those that are not
there are simulated into it (about a minute each, nine in all). The exit code is 1 if a check
fails.
"""

import json
import math
import os
import sys
import time
from dataclasses import asdict, dataclass

import numpy as np
from absl import app, flags
from tqdm import tqdm

from mpm import bodies, earthmoving, experiments, packing, raw_run, scenes
from mpm.batch import generate
from mpm.constitutive import make_soil
from mpm.motions import grid
from mpm.run import make_simulation
from mpm.simulation import Settings

_RAW_PATH = flags.DEFINE_string(
    'raw_path', os.path.join('outputs', 'verify'), 'Folder with the raw runs of both scenes.'
)
_JSON = flags.DEFINE_string('json', None, 'Write the table to this file, too.')
_NUM_PROCESSES = flags.DEFINE_integer('num_processes', 1, 'Runs at a time.', lower_bound=1)

# Upright blades (lean up to 10 degrees), both motions, several depths.
EARTHMOVING_CASES = (123, 146, 186, 213, 216)
EXPONENT_CASES = (22, 123, 146, 186, 216)
EXPONENT_TRAVEL = (0.15, 0.3)  # m of travel over which the draft is averaged
# Slip 20, "40", 70 % with the middle load, diameter and friction, on the Earth.
SLIP_CASES = (176, 203, 230)


@dataclass(frozen=True)
class Check:
    """One row: a figure, what it should be, and within what.

    Attributes:
        name: what is compared.
        figure: measured.
        expected: its exact or published value.
        tolerance: largest absolute difference.
        note: source, or what the figure is made of.
    """

    name: str
    figure: float
    expected: float
    tolerance: float
    note: str

    @property
    def passed(self) -> bool:
        """Whether the figure is within the tolerance."""
        return abs(self.figure - self.expected) <= self.tolerance


def kernel_checks() -> list[Check]:
    """Checks that need no run of a scene."""
    rows = []
    fall = experiments.free_fall()
    rows.append(
        Check('free fall: relative error', fall['error'], 0.0, 1e-6, 'of g dt2 n (n + 1) / 2')
    )
    rows.append(
        Check('free fall: change of shape', fall['deformation'], 0.0, 1e-6, 'over the fall')
    )
    for number in (0.01, 0.3):
        shear = experiments.homogeneous_shear(number)
        rows.append(
            Check(
                f'shear at I = {number}: tau/p over mu(I)',
                shear['tau_over_p'] / shear['mu'],
                1.0,
                0.01,
                'Jop et al. 2006',
            )
        )
    shear = experiments.homogeneous_shear(0.01, is_nonlocal=True)
    rows.append(
        Check(
            'nonlocal shear at I = 0.01: tau/p over steady mu',
            shear['tau_over_p'] / shear['mu'],
            1.0,
            0.01,
            'mu_s + (mu_2 - mu_s) I / I0',
        )
    )
    contact = experiments.contact_momentum()
    rows.append(
        Check(
            'contact: momentum not accounted for',
            contact['unbalanced'],
            0.0,
            1e-10,
            'over the impulse',
        )
    )
    for aspect in (1.0, 3.0):
        column = experiments.column_collapse(aspect)
        rows.append(
            Check(
                f'column collapse, a = {aspect:g}: run-out over published',
                column['runout'] / column['expected'],
                1.0,
                0.3,
                'channel, Lube et al. 2005',
            )
        )
    return rows


def packing_checks(scene: scenes.Scene, folder: str) -> list[Check]:
    """Checks of the settled soil of a scene."""
    settings = Settings()
    soil = make_soil(settings.youngs_modulus, scenes.PACKING_MU_S)
    particles, _ = packing.settled(scene.bin, soil, settings.seed, folder)
    figures = experiments.settled_soil(scene.bin, particles, soil)
    return [
        Check(
            f'{scene.name} soil: reaction of walls and floor over weight',
            figures['reaction_over_weight'],
            1.0,
            0.01,
            'm g',
        ),
        Check(
            f'{scene.name} soil: vertical stress over rho g h',
            figures['stress_over_rho_g_h'],
            1.0,
            0.02,
            'middle of the bin',
        ),
    ]


def earthmoving_ratio(run: raw_run.RawRun) -> float:
    """Returns mean draft over that of the fundamental equation, heap included, while cutting."""
    p = run.parameters
    scene = scenes.EXCAVATION
    box = scene.bin
    path = grid.make_drive(scene, p).pose(np.arange(scenes.FRAMES) / scenes.FRAME_RATE)
    lean = math.radians(p['angle_deg'])
    unit_weight = p['soil']['bulk_density'] * scenes.EARTH_GRAVITY
    kept_weight = unit_weight * packing.particle_volume(box) * box.keep_every
    ours, theirs = [], []
    for t in range(5, scenes.FRAMES - 5, 10):
        tip = path[t, :2] - [0.0, bodies.BLADE_THICKNESS / 2]
        depth = box.surface - tip[1]
        is_moving = path[t, 0] != path[t - 1, 0]
        is_ramp = p['motion'] == 1 and path[t, 1] != path[t - 1, 1]
        if not is_moving or is_ramp or depth < box.dx:
            continue
        soil = run.positions[t].astype(np.float64)
        ahead = tip[0] + (soil[:, 1] - tip[1]) * math.tan(lean) - soil[:, 0]
        is_heap = (
            (soil[:, 1] > box.surface)
            & (ahead > 0.0)
            & (np.abs(soil[:, 2] - box.z_middle) < bodies.BLADE_WIDTH / 2)
        )
        reach = tip[0] - soil[is_heap, 0]
        ours.append(run.force[t - 5 : t + 5, 0].mean())
        theirs.append(
            earthmoving.draft_force(
                depth,
                bodies.BLADE_WIDTH,
                math.pi / 2 - lean,
                math.asin(p['soil']['mu_s']),
                math.atan(bodies.BLADE_FRICTION),
                unit_weight,
                lambda limit, reach=reach: kept_weight * np.count_nonzero(reach < limit),
            )
        )
    return float(np.mean(ours) / np.mean(theirs))


def depth_exponents(runs: list[raw_run.RawRun]) -> tuple[float, float]:
    """Returns the exponent of the draft in depth: nominal depth, and depth of the contact.

    Each run gives a mean draft and a mean depth over the same stretch of travel. Contact begins
    `Body.outset` cells below the edge, which matters for the shallow cuts.
    """
    scene = scenes.EXCAVATION
    depths, drafts = [], []
    for run in runs:
        drive = grid.make_drive(scene, run.parameters)
        path = drive.pose(np.arange(scenes.FRAMES) / scenes.FRAME_RATE)
        travel = path[0, 0] - path[:, 0]
        chosen = (travel > EXPONENT_TRAVEL[0]) & (travel < EXPONENT_TRAVEL[1])
        edge = path[chosen, 1] - bodies.BLADE_THICKNESS / 2
        depths.append(scene.bin.surface - edge.mean())
        drafts.append(run.force[chosen, 0].mean())
    below = drive.body.outset * scene.bin.dx
    return tuple(
        float(np.polyfit(np.log(np.array(depths) + extra), np.log(drafts), 1)[0])
        for extra in (0.0, below)
    )


def halved_step(case: int = 186, frames: int = 60) -> float:
    """Returns the relative change of the mean force when the time step is halved."""
    scene = scenes.EXCAVATION
    parameters = scene.parameters(case)
    soil = make_soil(Settings().youngs_modulus, scenes.static_friction(scene, parameters))
    particles, _ = packing.settle(scene.bin, soil, 0)
    means = []
    steps = 0
    for factor in (1, 2):
        settings = Settings(steps_per_frame=factor * steps)
        simulation = make_simulation(scene, parameters, soil, particles, settings)
        steps = simulation.steps
        force = [
            simulation.frame()[0] for _ in tqdm(range(frames), desc='halved step', leave=False)
        ]
        means.append(np.mean(force, axis=0)[0])
    return float(means[1] / means[0] - 1.0)


def run_checks(raw_path: str, num_processes: int) -> list[Check]:
    """Checks that need whole runs, which are simulated where they are absent."""
    rows = []
    folder = os.path.join(raw_path, 'excavation')
    cases = sorted(set(EARTHMOVING_CASES + EXPONENT_CASES))
    generate(scenes.EXCAVATION, tuple(cases), folder, Settings(), num_processes)
    rows += packing_checks(scenes.EXCAVATION, folder)
    runs = {case: raw_run.read_run(os.path.join(folder, raw_run.file_name(case))) for case in cases}
    ratios = [earthmoving_ratio(runs[case]) for case in EARTHMOVING_CASES]
    rows.append(
        Check(
            'blade draft over the equation of earthmoving',
            float(np.mean(ratios)),
            1.0,
            0.3,
            'mean of cases '
            + ', '.join(f'{c}: {r:.2f}' for c, r in zip(EARTHMOVING_CASES, ratios))
            + '; phi = asin(mu_s), heap included',
        )
    )
    nominal, contact = depth_exponents([runs[case] for case in EXPONENT_CASES])
    rows.append(
        Check(
            'blade draft: exponent in depth of contact',
            contact,
            1.85,
            0.35,
            f'between 1.5 and 2.2; {nominal:.2f} in the depth of the edge, half a cell less',
        )
    )
    rows.append(
        Check(
            'halved time step: change of mean draft',
            halved_step(),
            0.0,
            0.02,
            'first second; APIC, see mpm/README.md',
        )
    )
    folder = os.path.join(raw_path, 'wheel')
    generate(scenes.WHEEL, SLIP_CASES, folder, Settings(), num_processes)
    rows += packing_checks(scenes.WHEEL, folder)
    worst, drawbar = 0.0, {}
    entries = raw_run.read_manifest(folder)['runs']
    for entry in entries:
        run = raw_run.read_run(os.path.join(folder, entry['file']))
        ratio = float(run.force[1:, 1].mean() / scenes.wheel_load(run.parameters))
        worst = ratio - 1.0 if abs(ratio - 1.0) > abs(worst) else worst
        drawbar[entry['case']] = -float(run.force[1:, 0].mean())
    rows.append(
        Check(
            'wheel: mean vertical force over load, worst run',
            1.0 + worst,
            1.0,
            0.03,
            f'of {len(entries)} runs',
        )
    )
    pulls = [drawbar[case] for case in SLIP_CASES]
    rows.append(
        Check(
            'wheel: smallest rise of drawbar pull with slip, N',
            float(np.diff(pulls).min()),
            100.0,
            100.0,
            'at 20, 38.5, 70 %: ' + ', '.join(f'{pull:.1f} N' for pull in pulls),
        )
    )
    return rows


def print_table(rows: list[Check]) -> None:
    """Prints the checks."""
    width = max(len(row.name) for row in rows)
    print(f'{"check":{width}}  {"figure":>10}  {"expected":>8}  {"within":>8}  result')
    for row in rows:
        print(
            f'{row.name:{width}}  {row.figure:10.4g}  {row.expected:8.4g}  {row.tolerance:8.2g}  '
            f'{"pass" if row.passed else "FAIL"}  {row.note}'
        )


def main(argv):
    if len(argv) > 1:
        raise app.UsageError(f'unknown arguments: {argv[1:]}')
    started = time.time()
    rows = kernel_checks() + run_checks(_RAW_PATH.value, _NUM_PROCESSES.value)
    print_table(rows)
    failed = sum(not row.passed for row in rows)
    print(f'{len(rows) - failed} of {len(rows)} checks pass; {time.time() - started:.0f} s')
    if _JSON.value:
        with open(_JSON.value, 'w', encoding='utf-8') as file:
            json.dump([asdict(row) | {'passed': row.passed} for row in rows], file, indent=1)
    sys.exit(1 if failed else 0)


if __name__ == '__main__':
    app.run(main)
