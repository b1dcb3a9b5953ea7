"""Measured beside published: single wheels over slip.

    python -m mpm.verification.anchors --json=mpm/verification/anchors.json \\
        --picture=mpm/verification/anchors.png

Nothing is tuned. Soil is cohesionless here; the sand of Ding et al. has 0.25 kPa. Each run is kept
in the JSON when it is made; the same command goes on with those that are absent (a minute of one
core each).

Sources: Ding et al. (2011), J. Terramechanics 48, 27; Wang, Han (2016), as digitised in public
(roverdevkit, MIT): drawbar pull (N), sinkage (mm), torque (N m) of a wheel over slip.
"""

import dataclasses
import json
import os
import sys
import time

import numpy as np
from absl import app, flags, logging
from tqdm import tqdm

from mpm import bodies, packing, run, scenes
from mpm.constitutive import make_soil
from mpm.files import write_json
from mpm.motions import catalogue
from mpm.motions.drive import Drive
from mpm.motions.grid import REST_FRAMES, WHEEL_START_X, under_load
from mpm.simulation import Settings
from mpm.versions import SOLVER_VERSION

_JSON = flags.DEFINE_string(
    'json', os.path.join('outputs', 'anchors.json'), 'Where runs are kept.'
)
_PICTURE = flags.DEFINE_string('picture', None, 'Picture: drawbar, sinkage, torque over slip.')

RIM_SPEED = 0.04  # m/s
FRAMES = 240
STEADY = 120  # the frames that are averaged, the last ones


@dataclasses.dataclass(frozen=True)
class Wheel:
    """A published wheel: its tool, load (N), soil; slip -> drawbar N, sinkage mm, torque N m."""

    tool: dict
    load: float
    ground: scenes.Ground
    slips: tuple
    drawbar: tuple
    sinkage: tuple
    torque: tuple


_DING = {'name': 'ding', 'radius': 0.15735, 'width': 0.165}
_DING_SOIL = scenes.Ground(31.9, 1605.0)
WHEELS = {
    'Ding, smooth': Wheel(
        _DING, 80.0, _DING_SOIL, (0.0, 0.1, 0.2, 0.3, 0.4, 0.6),
        (-6.5, 11.0, 14.5, 15.0, 15.0, 15.0), (5.0, 5.5, 7.5, 10.0, 12.5, 17.5),
        (0.0, 3.0, 4.2, 4.8, 5.0, 5.3),
    ),
    'Ding, 30 lugs of 10 mm': Wheel(
        _DING | {'grousers': {'count': 30, 'height': 0.01, 'thickness': 0.005}}, 80.0, _DING_SOIL,
        (0.0, 0.1, 0.2, 0.3, 0.4, 0.6), (-6.5, 14.0, 20.0, 22.0, 23.0, 24.5),
        (4.5, 5.0, 7.5, 10.5, 14.0, 27.0), (0.0, 3.5, 5.0, 5.8, 6.3, 7.2),
    ),
    'Wang & Han, smooth': Wheel(
        {'name': 'wang', 'radius': 0.085, 'width': 0.08}, 58.86, scenes.Ground(31.9),
        (0.1, 0.2, 0.3, 0.4, 0.5), (-0.5, 1.0, 2.0, 2.5, 0.5), (1.0, 4.3, 4.5, 5.7, 8.0),
        (1.3, 1.55, 1.9, 2.05, 2.05),
    ),
}  # fmt: skip


def drive_of(wheel: Wheel, slip: float) -> Drive:
    """Returns the drive of a wheel at a slip, its height free under the load."""
    body = bodies.tool_body(bodies.check_tool(wheel.tool))
    travel = RIM_SPEED * (1.0 - slip)

    def pose(times):
        driven = np.maximum(np.asarray(times, np.float64), 0.0)
        return np.stack(
            [
                WHEEL_START_X - travel * driven,
                np.zeros_like(driven),
                RIM_SPEED / body.radius * driven,
                np.full_like(driven, scenes.WHEEL.bin.z_middle),
            ],
            axis=1,
        )

    machine = under_load(wheel.load, lambda times: np.full(len(times), wheel.load))
    return Drive(body, pose, machine, rest=REST_FRAMES)


def measured(wheel: Wheel, slip: float, particles: np.ndarray) -> dict:
    """Returns drawbar (N), sinkage (mm) and torque (N m) of a wheel at a slip, steady means."""
    scene, settings = scenes.WHEEL, Settings()
    motion = catalogue.Motion('anchor', drive_of(wheel, slip), {}, FRAMES, wheel.ground)
    started = time.process_time()
    simulation = run.make_simulation(scene, motion, particles, settings)
    rows = []
    for _ in tqdm(range(FRAMES), leave=False):
        force, torque = simulation.frame()
        # The lowest point of the rim, as published; lugs reach deeper.
        sinkage = scene.bin.surface - (simulation.pose[1] - wheel.tool['radius'])
        rows.append([-force[0], 1e3 * sinkage, -torque[2]])
    drawbar, sinkage, moment = np.array(rows)[-STEADY:].mean(axis=0)
    return {
        'drawbar_N': round(float(drawbar), 3),
        'sinkage_mm': round(float(sinkage), 3),
        'torque_N_m': round(float(moment), 4),
        'cpu_s': round(time.process_time() - started, 1),
    }


def table(path: str) -> str:
    """Returns measured beside published as Markdown."""
    lines = [
        '| wheel | slip | drawbar N | published | sinkage mm | published '
        '| torque N m | published |',
        '|---|---|---|---|---|---|---|---|',
    ]
    for name, runs in _read(path).items():
        wheel = WHEELS[name]
        for slip, *published in zip(wheel.slips, wheel.drawbar, wheel.sinkage, wheel.torque):
            if found := runs.get(str(slip)):
                ours = found['drawbar_N'], found['sinkage_mm'], found['torque_N_m']
                cells = ' | '.join(f'{a:.1f} | {b:g}' for a, b in zip(ours, published))
                lines.append(f'| {name} | {slip:g} | {cells} |')
    return '\n'.join(lines)


def draw(path: str, output: str) -> None:
    """Draws drawbar, sinkage and torque over slip, measured and published."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    figure, rows = pyplot.subplots(1, 3, figsize=(11, 3.8), layout='constrained')
    names = (
        ('drawbar', 'drawbar_N', 'N'),
        ('sinkage', 'sinkage_mm', 'mm'),
        ('torque', 'torque_N_m', 'N m'),
    )
    for axes, (what, key, unit) in zip(rows, names):
        for number, (name, runs) in enumerate(_read(path).items()):
            wheel, colour = WHEELS[name], f'C{number}'
            published = getattr(wheel, what)
            axes.plot(wheel.slips, published, 'o--', color=colour, label=f'{name}, published')
            slips = [slip for slip in wheel.slips if str(slip) in runs]
            ours = [runs[str(s)][key] for s in slips]
            axes.plot(slips, ours, 's-', color=colour, label='this solver')
        axes.set_xlabel('slip')
        axes.set_ylabel(f'{what}, {unit}')
    rows[0].legend(fontsize=7)
    figure.savefig(output, dpi=120)


def _read(path) -> dict:
    if not os.path.exists(path):
        return {}
    with open(path, encoding='utf-8') as file:
        content = json.load(file)
    if content.get('solver_version') != SOLVER_VERSION:
        raise ValueError(f'{path} is not of solver version {SOLVER_VERSION}; name another')
    return content['wheels']


def main(argv):
    if len(argv) > 1:
        raise app.UsageError(f'unknown arguments: {argv[1:]}')
    path = _JSON.value
    try:
        content = _read(path)
        os.makedirs(os.path.dirname(path) or '.', exist_ok=True)
        particles, _ = packing.settle(scenes.WHEEL.bin, make_soil(1.5e6, scenes.PACKING_MU_S), 0)
        for name, wheel in WHEELS.items():
            for slip in wheel.slips:
                if str(slip) in content.setdefault(name, {}):
                    continue
                content[name][str(slip)] = measured(wheel, slip, particles)
                print(name, slip, content[name][str(slip)], flush=True)
                write_json(path, {'solver_version': SOLVER_VERSION, 'wheels': content})
        print(table(path))
        if _PICTURE.value:
            draw(path, _PICTURE.value)
    except (ValueError, OSError) as error:
        logging.error('%s', error)
        sys.exit(1)


if __name__ == '__main__':
    app.run(main)
