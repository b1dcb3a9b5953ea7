"""How far dry soil is similar: lengths in tool sizes, force in rho g w h^2.

    python -m mpm.verification.similarity --json=mpm/verification/similarity.json

A blade cuts along case 186 (8 cm deep, half an ellipse) in soil of another density, under another
gravity, at twice the size, and at other speeds. Without inertia and with rigid grains the force
over rho g w h^2 would be the same in all of them. Inertia enters as v^2 / (g h): where speeds go
with the root of gravity or size, the flow is similar even if inertia matters. Cells are 1.5 times
those of the ground truth (scaled with the tool), so that a run takes seconds.
"""

import dataclasses
import math
from functools import partial
from typing import NamedTuple

from mpm import bodies, scenes
from mpm.motions import catalogue, grid
from mpm.motions.drive import Drive, poses
from mpm.simulation import Settings
from mpm.solver import EXCHANGE
from mpm.verification.rows import Jobs, read_kept, run_report
from mpm.verification.run_rows import frames_of, simulation_of
from pca_tools.storage import markdown

DEPTH, SPEED, LEAN_DEG = 0.08, 0.1, 10.0  # of case 186: m, m/s, deg
TRAVEL = 0.16  # m at size 1; the force counts over its second half
MOON = 1.62  # m/s2


class World(NamedTuple):
    """What differs: lengths over the usual ones, speed (m/s), density (kg/m3), gravity (m/s2)."""

    size: float = 1.0
    speed: float = SPEED
    density: float = scenes.Ground().bulk_density
    gravity: float = scenes.EARTH_GRAVITY


WORLDS = {
    'case 186': World(),
    'density 1300 kg/m3': World(density=1300.0),
    'density 1900 kg/m3': World(density=1900.0),
    'gravity of the Moon': World(gravity=MOON),
    'gravity of the Moon, speed by its root': World(
        gravity=MOON, speed=SPEED * math.sqrt(MOON / scenes.EARTH_GRAVITY)
    ),
    'twice the size': World(size=2.0),
    'twice the size, speed by its root': World(size=2.0, speed=SPEED * math.sqrt(2.0)),
    '0.4 m/s': World(speed=0.4),
    '1 m/s': World(speed=1.0),
}


def measured(world: World) -> dict:
    """Returns mean draft and vertical force (N) over the second half of the travel, and the scale.

    `scale_N` is rho g w h^2 with the width w of the blade and the depth h of the cut.
    """
    size = world.size
    usual = scenes.EXCAVATION.bin
    box = scenes.sampled(
        tuple(size * side for side in usual.size), 1.5 * size * usual.dx, 1.5 * size * usual.dz,
        1, size * usual.height, tuple((0.0, 2.0 * size * high) for _, high in usual.bounds),
    )  # fmt: skip
    radius = size * bodies.BLADE_THICKNESS / 2
    tool = {
        'name': 'blade',
        'outline': [[0.0, 0.0], [0.0, size * bodies.BLADE_HEIGHT - 2 * radius]],
        'edge_radius': radius,
        'width': size * bodies.BLADE_WIDTH,
    }
    body = bodies.tool_body(bodies.check_tool(tool))
    x = scenes.CORNER + grid.TIP_START * box.size[0]
    y = box.surface + size * grid.TIP_CLEARANCE + radius

    def pose(times):
        way = size * grid.blade_displacement(2, DEPTH, world.speed / size, times)
        return poses(times, x + way[:, 0], y + way[:, 1], -math.radians(LEAN_DEG), box.z_middle)

    frames = max(4, round(size * TRAVEL / world.speed * scenes.FRAME_RATE))
    ground = scenes.Ground(bulk_density=world.density, gravity=world.gravity)
    motion = catalogue.Motion('similarity', Drive(body, pose), {}, frames, ground)
    # Fast soil crosses at most half a cell between exchanges.
    settings = Settings(exchange=EXCHANGE / max(1, round(world.speed / 0.8)))
    scene = dataclasses.replace(scenes.EXCAVATION, bin=box)
    force = frames_of(simulation_of(scene, motion, settings), frames)[frames // 2 :].mean(axis=0)
    scale = world.density * world.gravity * 2 * body.half_width * (size * DEPTH) ** 2
    return {
        'draft_N': round(float(force[0]), 3),
        'vertical_N': round(float(force[1]), 3),
        'scale_N': round(scale, 4),
        'inertia': round(world.speed**2 / (world.gravity * size * DEPTH), 5),
    }


def table(path: str) -> str:
    """Returns the runs as Markdown, each over the first."""
    runs, rows = read_kept(path).get('worlds', {}), []
    for name, found in runs.items():
        first = next(iter(runs.values()))
        scaled, usual = (
            [of[key] / of['scale_N'] for key in ('draft_N', 'vertical_N')] for of in (found, first)
        )
        changes = (f'{a / b - 1.0:+.1%}' for a, b in zip(scaled, usual))
        rows.append(
            (name, found['inertia'], f'{found["draft_N"]:.1f}', f'{scaled[0]:.2f}', *changes)
        )
    header = ('world', 'v^2 / (g h)', 'draft N', 'over rho g w h^2', 'against case 186', 'vertical')
    return markdown.table(header, rows)


def jobs(values=None) -> Jobs:
    """Returns what there is to make."""
    return {('worlds', name): partial(measured, world) for name, world in WORLDS.items()}


if __name__ == '__main__':
    run_report('similarity', jobs, table)
