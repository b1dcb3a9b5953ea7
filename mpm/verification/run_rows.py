"""Checks of whole runs: published laws of blade and wheel, presses, free tools, leak, density, and
pairs of runs that should agree."""

import math
import os
from functools import cache, partial

import numpy as np
from tqdm import tqdm

from mpm import bodies, earthmoving, packing, raw_run, run, scenes
from mpm.batch import generate
from mpm.motions import catalogue, grid
from mpm.motions.drive import Drive, Machine, poses
from mpm.scenes import EXCAVATION, WHEEL
from mpm.simulation import Settings, Simulation
from mpm.solver import EXCHANGE
from mpm.verification import bed
from mpm.verification.rows import Check

# Upright blades (lean up to 10 degrees), both motions, several depths.
EARTHMOVING_CASES = (123, 146, 186, 213, 216)
# It goes down 10 cm at 25 mm/s and hardly cuts, which the equation does not mean: only reported.
PLUNGING_CASE = 213
EXPONENT_CASES = (22, 123, 146, 186, 216)
EXPONENT_TRAVEL = (0.15, 0.3)  # m of travel over which the draft is averaged
SAW_TOOTH_CASES = (123, 186, 146)
LEVEL = 0.35  # largest slope of a cut that counts as level
# Slip 20, "40", 70 % with the middle load, diameter and friction, on the Earth.
SLIP_CASES = (176, 203, 230)
# Simulated for the rows of all runs of a folder: those of other rows.
FIRST_CASES = {'excavation': EARTHMOVING_CASES, 'wheel': SLIP_CASES}
HALVED_CASES = (186, 78, 146, 22, 188)  # motion 2: the blade is in the soil from the beginning
SHORT_CUTS = {'sleep': 'sleeping soil', 'single': 'steps in float32'}  # options of `Settings`
SHORT_CUT_CASES = (186, 78, 123, 146)
DENSITY_CASES = (186, 123, 146)
HALVED_FRAMES, PAIR_FRAMES = 80, 160
PRESS_SPEEDS = (0.01, 0.04, 0.16)  # m/s
PRESS_FROM, PRESS_BAND = 0.004, (0.012, 0.016)  # m: above the bed, and depths whose force counts
FREE_MASS = 20.0  # kg
# Runs are chaotic: one whose particles begin this far elsewhere has another mean force. The rows
# `noise_*` say by how much; no pair of runs can be asked for less than about twice that.
ELSEWHERE = 1e-9  # m
NOISE_CASES = (146, 186, 78)
HALVED_LIMIT = 0.012
# Of the mean force along x, by scene. That of a wheel is the small difference of thrust and
# resistance: 3 % of it are 0.4 N, 0.3 % of the load.
PAIR_LIMIT = {'excavation': 0.02, 'wheel': 0.03}
PAIR_SURFACE = 0.7  # mm


def rows_of(raw_path: str) -> dict:
    """Returns name -> function that makes the checks of that name; runs that a row needs are made
    in the folder of the raw runs of both scenes."""

    def each(name, make, cases, *arguments):
        return {f'{name}_{case}': partial(make, case, *arguments) for case in cases}

    rows: dict = each('halved', partial(halved_step, EXCAVATION), HALVED_CASES, HALVED_FRAMES)
    rows |= each('earthmoving', earthmoving_case, EARTHMOVING_CASES, raw_path)
    rows |= each('saw_tooth', saw_tooth_case, SAW_TOOTH_CASES, raw_path)
    rows |= {'press_rate': press_rate, 'set_down': set_down}
    for row in (depth_exponent, wheel_slip, wheel_load):
        rows[row.__name__] = partial(row, raw_path)
    rows |= {f'leak_{scene.name}': partial(leak, scene, raw_path) for scene in (EXCAVATION, WHEEL)}
    rows |= each('density', moved_soil, DENSITY_CASES)
    pairs: dict[str, tuple] = {'noise': (noise, NOISE_CASES)}
    pairs |= {name: (partial(short_cut, name), SHORT_CUT_CASES) for name in SHORT_CUTS}
    for name, (pair, cases) in pairs.items():
        rows |= each(name, partial(pair, EXCAVATION), cases, PAIR_FRAMES)
        rows |= each(f'{name}_wheel', partial(pair, WHEEL), (122,), PAIR_FRAMES)
    return rows | each('halved_wheel', partial(halved_step, WHEEL), (122, 203), PAIR_FRAMES)


@cache
def packed(box: scenes.Bin) -> np.ndarray:
    """Returns the usual settled packing of a bin, made once per process."""
    return packing.settle(box, Settings().youngs_modulus, Settings().seed)[0]


def simulation_of(
    scene: scenes.Scene, motion: catalogue.Motion, settings: Settings | None = None
) -> Simulation:
    """Returns the simulation of a motion on the usual soil of a scene."""
    return run.make_simulation(scene, motion, packed(scene.bin), settings or Settings())


def frames_of(simulation: Simulation, count: int) -> np.ndarray:
    """Advances a simulation; returns force (N) and torque (N m) on the body, [count, 6]."""
    frames = tqdm(range(count), unit='frame', leave=False)
    return np.array([np.concatenate(simulation.frame()) for _ in frames])


def drive(scene: scenes.Scene, case: int, frames: int, settings: Settings):
    """Returns force [frames, 3] (N) of a case, and the simulation after it."""
    made = simulation_of(scene, run.prepared(scene, case, settings), settings)
    return frames_of(made, frames)[:, :3], made


def halved_step(scene: scenes.Scene, case: int, frames: int) -> list[Check]:
    """The relative change of the mean force along x when the time step is halved."""
    usual = drive(scene, case, frames, Settings())
    halved = Settings(steps=2 * round(EXCHANGE / usual[1].dt))
    finer = drive(scene, case, frames, halved)
    name = f'{scene.name} {case}: halved step'
    return _apart(name, scene, finer, usual, 0.0, HALVED_LIMIT)[:1]


def short_cut(option: str, scene: scenes.Scene, case: int, frames: int) -> list[Check]:
    """What a short cut changes, against the run without it: mean force along x, and the soil."""
    usual = drive(scene, case, frames, Settings())
    without = drive(scene, case, frames, Settings(**{option: False}))
    name = f'{scene.name} {case}: {SHORT_CUTS[option]}'
    return _apart(name, scene, usual, without, 0.0, PAIR_LIMIT[scene.name])


def noise(scene: scenes.Scene, case: int, frames: int) -> list[Check]:
    """How far runs come apart whose particles begin 1e-9 m elsewhere."""
    settings, particles = Settings(), packed(scene.bin).copy()
    particles[:, 0] += ELSEWHERE
    other = run.make_simulation(scene, run.prepared(scene, case, settings), particles, settings)
    moved = frames_of(other, frames)[:, :3], other
    name = f'{scene.name} {case}: particles begin 1e-9 m elsewhere'
    usual = drive(scene, case, frames, settings)
    return _apart(name, scene, usual, moved, None, PAIR_LIMIT[scene.name])


def _apart(name, scene, one, other, expected, limit) -> list[Check]:
    """Checks of the mean force along x and the surface of a run against those of another."""
    (force, simulation), (without, reference) = one, other
    mean, change = without[:, 0].mean(), force[:, 0].mean() / without[:, 0].mean() - 1.0
    here, there = simulation.positions(), reference.positions()
    apart = bed.surface(here, scene.bin) - bed.surface(there, scene.bin)
    rms = 1e3 * float(np.sqrt((apart**2).mean()))
    soil = 1e3 * np.sqrt(((here - there) ** 2).sum(axis=1).mean())
    note = f'{len(force)} frames, {mean:.1f} N; all soil {soil:.2f} mm apart at the end'
    return [
        Check(f'{name}, change of the mean force', change, expected, limit, note),
        Check(f'{name}, surface in mm RMS', rms, expected, PAIR_SURFACE, 'at the end'),
    ]


def moved_soil(case: int) -> list[Check]:
    """The density of soil that a blade has moved, over that of the bed before."""
    frames = scenes.FRAMES - 1
    _, simulation = drive(EXCAVATION, case, frames, Settings())
    start, end = packed(EXCAVATION.bin)[:, :3], simulation.positions()
    density = bed.moved_density(start, end, simulation)
    name = f'excavation {case}: density of soil that moved over {1e3 * bed.MOVED:.0f} mm'
    return [Check(name, density, 1.005, 0.025, f'{frames} frames, over that of the bed')]


def run_of(scene: scenes.Scene, case: int, raw_path: str) -> run.RawRun:
    """Returns a run of a folder, simulated into it if it is absent."""
    folder = os.path.join(raw_path, scene.name)
    generate(scene, (case,), folder, Settings())
    return raw_run.read_run(os.path.join(folder, raw_run.file_name(case)))


def runs_held(scene: scenes.Scene, raw_path: str) -> list[dict]:
    """Returns the manifest's entries of all runs of a folder, `FIRST_CASES` among them."""
    folder = os.path.join(raw_path, scene.name)
    generate(scene, FIRST_CASES[scene.name], folder, Settings())
    return raw_run.read_manifest(folder)['runs']


def path_of(parameters: dict, frames: int = scenes.FRAMES) -> np.ndarray:
    """Returns the poses [frames, 4] of the blade in a case of the grid."""
    drive = grid.make_drive(EXCAVATION, parameters)
    return drive.pose(np.arange(frames) / scenes.FRAME_RATE)


def earthmoving_case(case: int, raw_path: str) -> list[Check]:
    """The mean draft of one case over that of the fundamental equation, while it cuts."""
    made = run_of(EXCAVATION, case, raw_path)
    p, box, path = made.parameters, EXCAVATION.bin, path_of(made.parameters)
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
        x, y, z = made.positions[t].astype(np.float64).T
        is_ahead = tip[0] + (y - tip[1]) * math.tan(lean) - x > 0.0
        is_heap = is_ahead & (y > box.surface) & (np.abs(z - box.z_middle) < bodies.BLADE_WIDTH / 2)
        reach = tip[0] - x[is_heap]
        ours.append(made.force[t - 5 : t + 5, 0].mean())
        theirs.append(
            earthmoving.draft_force(
                depth, bodies.BLADE_WIDTH, math.pi / 2 - lean, math.asin(p['soil']['mu_s']),
                math.atan(bodies.BLADE_FRICTION), unit_weight,
                lambda limit, reach=reach: kept_weight * np.count_nonzero(reach < limit),
            )
        )  # fmt: skip
    ratio = float(np.mean(ours) / np.mean(theirs))
    name = f'excavation {case}: draft over the equation of earthmoving'
    expected = None if case == PLUNGING_CASE else 1.0
    return [Check(name, ratio, expected, 0.3, 'phi = asin(mu_s), heap included')]


def depth_exponent(raw_path: str) -> list[Check]:
    """The exponent of the draft in depth, over the same stretch of travel.

    A sharp plate in fresh soil has 2. The heap, which after a travel l weighs as l times the depth,
    and the round edge, which presses as much soil in a shallow cut as in a deep one, bring it
    down towards 1.
    """
    scene, depths, drafts = EXCAVATION, [], []
    for case in EXPONENT_CASES:
        made = run_of(scene, case, raw_path)
        path = path_of(made.parameters)
        travel = path[0, 0] - path[:, 0]
        chosen = (travel > EXPONENT_TRAVEL[0]) & (travel < EXPONENT_TRAVEL[1])
        edge = path[chosen, 1].mean() - bodies.BLADE_THICKNESS / 2
        depths.append(scene.bin.surface - edge)
        drafts.append(made.force[chosen, 0].mean())
    # Contact begins half a spacing of particles below the edge.
    radius = 0.5 * scene.bin.size[1] / scene.bin.lattice[1]
    nominal, exponent = (
        float(np.polyfit(np.log(np.array(depths) + extra), np.log(drafts), 1)[0])
        for extra in (0.0, radius)
    )
    note = f'between 1 and 2.2; {nominal:.2f} in the depth of the edge'
    return [Check('blade draft: exponent in depth of contact', exponent, 1.6, 0.6, note)]


def saw_tooth(force: np.ndarray, speed: float, dx: float) -> float:
    """Returns the amplitude of a force [T] (N, at the frame rate) at the rate at which cells of
    `dx` (m) are crossed at a constant speed (m/s), over its mean."""
    frames = len(force)
    t = np.linspace(-1.0, 1.0, frames)
    window = np.hanning(frames)
    rest = force - np.polyval(np.polyfit(t, force, 3), t)
    rate = np.arange(frames) / scenes.FRAME_RATE
    # Within a tenth of the rate, as fine as the window tells apart.
    tones = speed / dx * np.linspace(0.9, 1.1, 21)
    waves = np.exp(-2j * np.pi * tones[:, None] * rate)
    amplitude = 2.0 * np.abs(waves @ (window * rest)).max() / window.sum()
    return float(amplitude / abs(force.mean()))


def cutting_frames(parameters: dict, count: int) -> np.ndarray:
    """Returns which of the first `count` frames cut at the run's speed and about level, int [K].

    The first quarter of that stretch is left out: the draft still builds up.
    """
    step = np.diff(path_of(parameters, count)[:, :2], axis=0)
    way = parameters['speed_m_s'] / scenes.FRAME_RATE
    is_steady = (np.abs(-step[:, 0] - way) < 1e-6 * way) & (np.abs(step[:, 1]) < LEVEL * way)
    steady = np.flatnonzero(is_steady) + 1
    return steady[len(steady) // 4 :]


def saw_tooth_case(case: int, raw_path: str) -> list[Check]:
    """The force's saw-tooth at the cell-crossing rate."""
    run = run_of(EXCAVATION, case, raw_path)
    speed, dx = run.parameters['speed_m_s'], run.parameters['cell_m'][0]
    cuts = cutting_frames(run.parameters, len(run.force))
    share = saw_tooth(run.force[cuts, 0].astype(np.float64), speed, dx)
    name = f'excavation {case}: saw-tooth over the mean force'
    return [Check(name, share, 0.0, 0.05, f'at {speed / dx:.1f} Hz')]


def leak(scene: scenes.Scene, raw_path: str) -> list[Check]:
    """The deepest particle in the body, of all runs that the folder holds."""
    found = [run['parameters'] for run in runs_held(scene, raw_path)]
    deepest = max(p['penetration_deepest_cells'] for p in found)
    inside = sum(p['penetration_inside'] for p in found)
    note = f'{len(found)} runs, all frames; {inside} particles deeper than a quarter of a cell'
    return [Check(f'{scene.name}: deepest particle in the body, cells', deepest, 0.0, 0.25, note)]


def wheel_load(raw_path: str) -> list[Check]:
    """The soil carries the wheel: mean vertical force over load, of all runs of the folder."""
    folder = os.path.join(raw_path, WHEEL.name)
    ratios = {}
    for entry in runs_held(WHEEL, raw_path):
        run = raw_run.read_run(os.path.join(folder, entry['file']))
        load = run.step_context[1:, WHEEL.context_names.index('load')]
        ratios[entry['case']] = float(run.force[1:, 1].mean() / load.mean())
    worst = max(ratios, key=lambda case: abs(ratios[case] - 1.0))
    note = f'worst of {len(ratios)} runs: {worst}'
    return [Check('wheel: mean vertical force over load', ratios[worst], 1.0, 0.03, note)]


def wheel_slip(raw_path: str) -> list[Check]:
    """The drawbar pull grows with slip."""
    pulls = [-float(run_of(WHEEL, case, raw_path).force[1:, 0].mean()) for case in SLIP_CASES]
    note = 'at 20, 38.5, 70 %: ' + ', '.join(f'{pull:.1f} N' for pull in pulls)
    name = 'wheel: smallest rise of drawbar pull with slip, N'
    return [Check(name, float(np.diff(pulls).min()), 100.0, 100.0, note)]


def _upright_blade(height, machine=None):
    """The blade in the middle of the bin; `height` (m above the bed) is a function of times (s)."""
    box, body = EXCAVATION.bin, bodies.make_blade()

    def pose(times):
        above = box.surface + body.radius + height(np.maximum(times, 0.0))
        return poses(times, scenes.CORNER + box.size[0] / 2, above, 0.0, box.z_middle)

    motion = catalogue.Motion('row', Drive(body, pose, machine), {}, 0, scenes.Ground())
    return simulation_of(EXCAVATION, motion)


def press_rate() -> list[Check]:
    """Dry soil answers a press as strongly when it is fast: F ~ v^n with n near 0."""
    forces = []
    for speed in PRESS_SPEEDS:
        simulation = _upright_blade(lambda t, speed=speed: PRESS_FROM - speed * t)
        seen = []
        while (depth := (simulation.time * speed) - PRESS_FROM) < PRESS_BAND[1]:
            simulation.frame()
            quarters = depth + speed / scenes.FRAME_RATE * (np.arange(4) + 0.5) / 4
            is_in = (quarters >= PRESS_BAND[0]) & (quarters <= PRESS_BAND[1])
            seen += simulation.loads[is_in, 1].tolist()
        forces.append(float(np.mean(seen)))
    exponent = float(np.polyfit(np.log(PRESS_SPEEDS), np.log(forces), 1)[0])
    note = ', '.join(f'{1e3 * v:g} mm/s {f:.0f} N' for v, f in zip(PRESS_SPEEDS, forces))
    return [Check('press: exponent of the force in the speed', exponent, 0.0, 0.05, note)]


def set_down() -> list[Check]:
    """A blade that is free in height comes to rest under its weight, and the soil carries it."""
    weight = FREE_MASS * scenes.EARTH_GRAVITY

    def force(times):
        return -weight * np.clip(times / 0.4, 0.0, 1.0)[:, None] * [0.0, 1.0, 0.0]

    machine = Machine((False, True, False), FREE_MASS, force)
    simulation = _upright_blade(lambda t: np.full(len(t), 0.003), machine)
    heights, forces = [], []
    for _ in range(210):
        forces.append(simulation.frame()[0][1])
        heights.append(simulation.pose[1])
    drift = 1e3 * abs(heights[-1] - heights[179]) / 0.5
    depth = 1e3 * (EXCAVATION.bin.surface + bodies.BLADE_THICKNESS / 2 - heights[-1])
    share = np.mean(forces[180:]) / weight
    name = f'blade of {FREE_MASS:g} kg, free in height'
    return [
        Check(f'{name}: drift after 3 s, mm/s', drift, 0.0, 0.05, f'{depth:.1f} mm deep'),
        Check(f'{name}: force over weight', share, 1.0, 0.005, '3 to 3.5 s'),
        Check(f'{name}: depth of the edge, mm', depth, note='after 3.5 s'),
    ]
