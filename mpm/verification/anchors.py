"""Measured beside published: wheels over slip, a ball that is dropped.

    python -m mpm.verification.anchors --json=mpm/verification/anchors.json \\
        --picture=mpm/verification/anchors.png

Nothing is tuned. Soil is cohesionless here; the sand of Ding et al. has 0.25 kPa. Each run is kept
in the JSON when it is made; the same command goes on with those that are absent (one to two minutes
of one core each).

Sources:
  wheels: Ding et al. (2011), J. Terramechanics 48, 27; Wang, Han (2016), as digitised in public
    (roverdevkit, MIT): drawbar pull (N), sinkage (mm), torque (N m) of a wheel over slip.
  ball: Uehara, Ambroso, Ojha, Durian (2003), Phys. Rev. Lett. 90, 194301: the depth d that a ball
    reaches when it falls through H = h + d onto dry grains,
    d = 0.14 / mu (rho_ball / rho)^(1/2) diameter^(2/3) H^(1/3), mu the tangent of the repose angle.
"""

import dataclasses
import itertools
import math
from functools import partial

import numpy as np

from mpm import bodies, scenes
from mpm.motions import catalogue, grid
from mpm.motions.drive import Drive, Machine, poses, under_load
from mpm.picture import panels
from mpm.verification.rows import Jobs, read_kept, run_report
from pca_tools.storage import markdown

RIM_SPEED = 0.04  # m/s
FRAMES = 150
STEADY = 60  # the frames that are averaged, the last ones
# The wheel scene's cells in a larger bin: 45 mm beside the widest wheel, 75 mm of soil.
BIN = scenes.sampled(
    (0.5, 0.075, 20 * scenes.WHEEL.bin.dz), 0.5 / 120, scenes.WHEEL.bin.dz, 1, 0.25,
    ((0.0, 0.8), (0.0, 0.6), (0.0, 0.6)),
)  # fmt: skip
RUN_SLIPS = (0.1, 0.3, 0.5, 0.6)  # of the published ones, those that are run
START_X = scenes.CORNER + 0.32


@dataclasses.dataclass(frozen=True)
class Wheel:
    """A published wheel: tool, load (N), soil; slip -> drawbar N, sinkage mm, torque N m."""

    tool: dict
    load: float
    ground: scenes.Ground
    published: dict


_DING = {'name': 'ding', 'radius': 0.15735, 'width': 0.165}
_DING_SOIL = scenes.Ground(31.9, 1605.0)
WHEELS = {
    'Ding, smooth': Wheel(
        _DING, 80.0, _DING_SOIL,
        {0.0: (-6.5, 5.0, 0.0), 0.1: (11.0, 5.5, 3.0), 0.2: (14.5, 7.5, 4.2),
         0.3: (15.0, 10.0, 4.8), 0.4: (15.0, 12.5, 5.0), 0.6: (15.0, 17.5, 5.3)},
    ),
    'Ding, 30 lugs of 10 mm': Wheel(
        _DING | {'grousers': {'count': 30, 'height': 0.01, 'thickness': 0.005}}, 80.0, _DING_SOIL,
        {0.0: (-6.5, 4.5, 0.0), 0.1: (14.0, 5.0, 3.5), 0.2: (20.0, 7.5, 5.0),
         0.3: (22.0, 10.5, 5.8), 0.4: (23.0, 14.0, 6.3), 0.6: (24.5, 27.0, 7.2)},
    ),
    'Wang & Han, smooth': Wheel(
        {'name': 'wang', 'radius': 0.085, 'width': 0.08}, 58.86, scenes.Ground(31.9),
        {0.1: (-0.5, 1.0, 1.3), 0.2: (1.0, 4.3, 1.55), 0.3: (2.0, 4.5, 1.9),
         0.4: (2.5, 5.7, 2.05), 0.5: (0.5, 8.0, 2.05)},
    ),
}  # fmt: skip
# What is measured of a wheel, in the order of what is published: name in the file -> title.
MEASURED = {'drawbar_N': 'drawbar, N', 'sinkage_mm': 'sinkage, mm', 'torque_N_m': 'torque, N m'}

DROPS = (0.05, 0.1, 0.2)  # m, from the lowest point of the ball to the bed
BALL_DIAMETER, BALL_DENSITY = 0.05, 2200.0  # m, kg/m3
BALL_BIN = scenes.sampled((0.3, 0.12, 0.3), 0.005, 0.005, 1, 0.3, ((0.0, 0.5),) * 3)
BALL_FRAMES = 30


def ball_depth(drop: float, friction_deg: float, density: float) -> float:
    """Returns the published depth (m) of the ball that is dropped from a height (m)."""
    scale = 0.14 / math.tan(math.radians(friction_deg)) * math.sqrt(BALL_DENSITY / density)
    depth = 0.0
    for _ in range(100):  # d on both sides: H = h + d
        depth = scale * BALL_DIAMETER ** (2.0 / 3.0) * (drop + depth) ** (1.0 / 3.0)
    return depth


def dropped(drop: float) -> dict:
    """Returns how deep (mm) a ball goes that falls onto the bed, and the published depth."""
    from mpm.simulation import Settings  # help does not wait for Numba
    from mpm.solver import EXCHANGE
    from mpm.verification import run_rows

    ground, box = scenes.Ground(), BALL_BIN
    body = bodies.make_ball(BALL_DIAMETER)
    mass = BALL_DENSITY * math.pi * BALL_DIAMETER**3 / 6.0
    # It touches grains half a spacing above the surface.
    start = (scenes.CORNER + box.size[0] / 2, box.surface + body.radius + 0.002, 0.0, box.z_middle)

    def force(times):
        return np.tile([0.0, -mass * ground.gravity, 0.0], (len(times), 1))

    machine = Machine((False, True, False), mass, force)
    drive = Drive(body, lambda times: poses(times, *start), machine)
    motion = catalogue.Motion('ball', drive, {}, BALL_FRAMES, ground)
    scene = dataclasses.replace(scenes.EXCAVATION, bin=box)
    # Soil below a ball of 2 m/s would cross a cell between the usual exchanges.
    simulation = run_rows.simulation_of(scene, motion, Settings(exchange=EXCHANGE / 2))
    simulation.free.state[1, 1] = -math.sqrt(2.0 * ground.gravity * drop)
    lowest = []
    for _ in range(BALL_FRAMES):
        simulation.frame()
        lowest.append(simulation.pose[1] - body.radius)
    published = ball_depth(drop, ground.friction_angle_deg, ground.bulk_density)
    return {
        'depth_mm': round(1e3 * (box.surface - min(lowest)), 3),
        'published_mm': round(1e3 * published, 3),
        'speed_at_end_m_s': round(float(simulation.free.state[1, 1]), 5),
    }


def measured(wheel: Wheel, slip: float) -> dict:
    """Returns drawbar (N), sinkage (mm) and torque (N m) of a wheel at a slip, its height free
    under the load: steady means."""
    from mpm.verification import run_rows  # help does not wait for Numba

    body = bodies.tool_body(bodies.check_tool(wheel.tool))

    def pose(times):
        way = RIM_SPEED * np.maximum(np.asarray(times, np.float64), 0.0)
        return poses(times, START_X - (1.0 - slip) * way, 0.0, way / body.radius, BIN.z_middle)

    drive = Drive(body, pose, under_load(wheel.load), rest=grid.REST_FRAMES)
    motion = catalogue.Motion('anchor', drive, {}, FRAMES, wheel.ground)
    scene = dataclasses.replace(scenes.WHEEL, bin=BIN)
    simulation, rows = run_rows.simulation_of(scene, motion), []
    for _ in range(FRAMES):
        force, torque = simulation.frame()
        # The lowest point of the rim, as published; lugs reach deeper.
        sinkage = scene.bin.surface - (simulation.pose[1] - wheel.tool['radius'])
        rows.append([-force[0], 1e3 * sinkage, -torque[2]])
    means = np.array(rows)[-STEADY:].mean(axis=0)
    return {name: round(float(mean), n) for name, mean, n in zip(MEASURED, means, (3, 3, 4))}


def wheel_table(path: str) -> str:
    rows = []
    for name, runs in read_kept(path).get('wheels', {}).items():
        for slip, published in WHEELS[name].published.items():
            if found := runs.get(str(slip)):
                pairs = [(f'{found[a]:.1f}', f'{b:g}') for a, b in zip(MEASURED, published)]
                rows.append((name, f'{slip:g}', *itertools.chain(*pairs)))
    titles = ((title, 'published') for title in MEASURED.values())
    return markdown.table(('wheel', 'slip', *itertools.chain(*titles)), rows)


def ball_table(path: str) -> str:
    rows = [
        (f'{1e3 * float(drop):g}', f'{found["depth_mm"]:.1f}', f'{found["published_mm"]:.1f}')
        for drop, found in read_kept(path).get('balls', {}).items()
    ]
    return markdown.table(('ball dropped by, mm', 'depth, mm', 'published'), rows)


def draw(path: str, output: str) -> None:
    """Draws drawbar, sinkage and torque over slip, measured and published."""
    figure, (row,) = panels(1, 3, (3.7, 3.8))
    for number, (axes, (what, title)) in enumerate(zip(row, MEASURED.items())):
        for colour, (name, runs) in enumerate(read_kept(path).get('wheels', {}).items()):
            slips = WHEELS[name].published
            theirs = [values[number] for values in slips.values()]
            axes.plot(list(slips), theirs, 'o--', color=f'C{colour}', label=f'{name}, published')
            made = [slip for slip in slips if str(slip) in runs]
            ours = [runs[str(slip)][what] for slip in made]
            axes.plot(made, ours, 's-', color=f'C{colour}', label='this solver')
        axes.set_xlabel('slip')
        axes.set_ylabel(title)
    row[0].legend(fontsize=7)
    figure.savefig(output, dpi=120)


def jobs(values=None) -> Jobs:
    balls: Jobs = {('balls', str(drop)): partial(dropped, drop) for drop in DROPS}
    return balls | {
        ('wheels', name, str(slip)): partial(measured, wheel, slip)
        for name, wheel in WHEELS.items()
        for slip in wheel.published
        if slip in RUN_SLIPS
    }


if __name__ == '__main__':
    run_report('anchors', jobs, lambda path: f'{wheel_table(path)}\n\n{ball_table(path)}', draw)
