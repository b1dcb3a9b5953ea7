"""A blade that a machine carries, drawn from a seed: pressed, set down, or pulled by actuators.

press: pushed straight down at changing speeds, held, unloaded by a little or lifted out, and pushed
    down again, deeper or beside; on a path.
free: a blade is set down on the soil under its weight, which grows over 0.4 s, and settles; 5 to
    20 kg are then dragged, up to 200 kg stay where they are. The height is free, in some runs the
    way along or the lean as well, held by springs.
actuated: x and y are free and pulled along the path of an operator by springs with dampers (1e4 to
    2e5 N/m, 10 to 100 kg); where the soil is too strong, the blade lags behind or stalls.
"""

import math

import numpy as np

from mpm import bodies, scenes
from mpm.motions import checks, grid, operator_paths
from mpm.motions.drive import Drive, Levels, Machine, Track, poses

KINDS = ('press', 'free', 'actuated')
MASSES = (5.0, 200.0)  # kg, set down
# kg, dragged: nothing holds the height, and 30 kg dig themselves in by 10 cm on 0.3 m.
DRAGGED_MASSES, DRAGGED_LEAN, DRAGGED_FACTOR = (5.0, 20.0), 30.0, 1.25
ACTUATED_MASSES = (10.0, 100.0)  # kg
STIFFNESS = (1.0e4, 2.0e5)  # N/m
PRESS_SPEEDS = (0.005, 0.16)  # m/s
PRESS_DEPTH = 0.06  # m
GROWTH = 0.4  # s, in which a weight grows


def machine_drive(
    scene: scenes.Scene, kind: str, seed: int, tool: dict | None = None
) -> tuple[Drive, dict]:
    """Draws a drive of one of `KINDS`, of the blade if there is no other tool.

    Returns the drive and its parameters, JSON-compatible; `machine` among them where something is
    free. ValueError: a bin in which no path fits.
    """
    rng = np.random.default_rng([seed, KINDS.index(kind), 3])
    if kind == 'actuated':
        return _actuated(rng, scene, seed, tool)
    is_narrow = tool is None and rng.random() < 0.3
    width = operator_paths.NARROW_WIDTH if is_narrow else bodies.BLADE_WIDTH
    body, kept = bodies.blade_or(tool, width)
    draw = _press if kind == 'press' else _set_down
    drive, drawn = checks.first_that_fits(
        lambda: draw(rng, scene.bin, body), scene.bin, f'{kind!r}, seed {seed}'
    )
    return drive, kept | drawn


def _press(rng, box, body):
    lean = float(rng.choice([0.0, rng.uniform(0.0, 45.0)]))
    x = rng.uniform(0.45, 0.72)
    track, speeds = Track(depth=-grid.TIP_CLEARANCE, x=x), []
    track.add(0.1)
    while track.time < scenes.DURATION:
        start = max(track.last('depth'), 0.0)
        depth = rng.uniform(min(start + 0.005, PRESS_DEPTH), PRESS_DEPTH + 0.01)
        speed = math.exp(rng.uniform(*np.log(PRESS_SPEEDS)))
        speeds.append(round(speed, 4))
        # The mean speed of a quintic piece is 1 / PEAK of its largest.
        track.add(max(abs(depth - track.last('depth')) / speed, 0.05), depth=depth)
        track.add(rng.uniform(0.2, 1.0))
        way = rng.random()
        if way < 0.5:  # unloaded, and loaded again
            track.add(rng.uniform(0.1, 0.3), depth=depth - rng.uniform(0.0005, 0.004))
            track.add(rng.uniform(0.1, 0.4))
        elif way < 0.75:  # out, and down beside
            track.add(rng.uniform(0.4, 0.8), depth=-0.01)
            place = float(np.clip(track.last('x') + rng.uniform(-0.06, 0.06), 0.42, 0.74))
            track.add(0.4, depth=-0.01, x=place)
    down, along = track.levels('depth'), track.levels('x')
    theta = -math.radians(lean)
    base = box.surface - float(bodies.lowest(body, np.array(theta)))

    def pose(t):
        return poses(t, along(t), base - down(t), theta, box.z_middle)

    return Drive(body, pose), {'lean_deg': lean, 'press_speeds_m_s': speeds}


def _set_down(rng, box, body):
    is_dragged = rng.random() < 0.7
    lean = float(rng.choice([0.0, rng.uniform(0.0, DRAGGED_LEAN if is_dragged else 45.0)]))
    mass = math.exp(rng.uniform(*np.log(DRAGGED_MASSES if is_dragged else MASSES)))
    theta = -math.radians(lean)
    base = box.surface - float(bodies.lowest(body, np.array(theta)))
    x = rng.uniform(0.6, 0.78)
    settles = rng.uniform(1.2, 2.5)
    speed = rng.uniform(0.03, 0.12) if is_dragged else 0.0
    halts = rng.uniform(settles + 1.0, scenes.DURATION)
    moments = [0.0, settles, settles + 0.4, halts, halts + 0.4]
    travel = Levels(moments, [0.0, 0.0, speed, speed, 0.0])
    grows = Levels([0.05, 0.05 + GROWTH], [0.0, 1.0])
    # A load on top, that changes once.
    most = DRAGGED_FACTOR if is_dragged else max(1.0, min(1.8, MASSES[1] / mass))
    changed = rng.uniform(0.4, most) if rng.random() < 0.5 else 1.0
    when = rng.uniform(0.5, scenes.DURATION - 0.5)
    factor = Levels([when, when + 0.2], [1.0, changed])
    inertia = mass * 0.15**2
    stiffness = np.zeros(3)
    if rng.random() < 0.3:
        stiffness[0] = math.exp(rng.uniform(*np.log(STIFFNESS)))
    if rng.random() < 0.2:
        stiffness[2] = math.exp(rng.uniform(math.log(500.0), math.log(5000.0)))
    damping = 2.0 * np.sqrt(stiffness * [mass, mass, inertia])
    is_free = bool(stiffness[0]), True, bool(stiffness[2])

    def force(t):
        weight = -mass * scenes.EARTH_GRAVITY * grows(t) * factor(t)
        return np.stack([np.zeros_like(weight), weight, np.zeros_like(weight)], axis=1)

    def pose(t):
        return poses(t, x - travel.integral(t), base + 0.002, theta, box.z_middle)

    machine = Machine(is_free, mass, force, inertia, tuple(stiffness), tuple(damping))
    return Drive(body, pose, machine), {
        'lean_deg': lean,
        'drag_speed_m_s': round(speed, 4),
        'load_factor': round(changed, 4),
        'machine': described(machine),
    }


def _actuated(rng, scene, seed, tool):
    path_kind = str(rng.choice(['smooth', 'stops', 'reverse', 'lift']))
    # A path of its own: seeds of operators are below a million.
    drive, drawn = operator_paths.operator_drive(scene, path_kind, seed + 1_000_000, tool)
    mass = math.exp(rng.uniform(*np.log(ACTUATED_MASSES)))
    stiffness = np.exp(rng.uniform(*np.log(STIFFNESS), size=2))
    damping = rng.uniform(0.5, 1.2) * 2.0 * np.sqrt(stiffness * mass)

    actuators = (*stiffness, 0.0), (*damping, 0.0)
    machine = Machine((True, True, False), mass, lambda t: np.zeros((len(t), 3)), 0.0, *actuators)
    carried = Drive(drive.body, drive.pose, machine, drive.lead_in)
    return carried, drawn | {'plot': path_kind, 'machine': described(machine)}


def described(machine: Machine) -> dict:
    return {
        'is_free': list(machine.is_free),
        'mass_kg': round(machine.mass, 6),
        'inertia_kg_m2': round(machine.inertia, 6),
        'stiffness': [round(float(k), 4) for k in machine.stiffness],
        'damping': [round(float(c), 4) for c in machine.damping],
    }
