"""One run: from the settled packing to the arrays of a raw run."""

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mpm import DATA_VERSION, SOLVER_VERSION, bodies, scenes, splits, stability
from mpm.constitutive import Soil, friction_coefficient, make_soil
from mpm.height_map import HeightMap
from mpm.motions import checks
from mpm.motions.catalogue import Motion, motion_of
from mpm.motions.recording import Recording
from mpm.simulation import Settings, Simulation


@dataclass(frozen=True)
class RawRun:
    """The arrays of one run, as written to disk: float32 with T frames first."""

    positions: np.ndarray  # [T, N, 3], m
    rigid_positions: np.ndarray  # [T, R, 3], m
    # force, torque: [T, 3], N and N m about the body's reference point, on the body by the soil,
    # mean over the frame that ends at t
    force: np.ndarray
    parameters: dict  # what was run, JSON-compatible
    torque: np.ndarray
    # [T, 7], position (m) of the reference point and unit quaternion (w, x, y, z) that turns the
    # upright body
    pose: np.ndarray
    # [T, C], values of the scene's `context_names` at each frame (the load may vary); None if it
    # has none
    step_context: np.ndarray | None = None
    # target, external, subframe_force: of a free body alone: [T, 3], x, y (m) and angle (rad) that
    # its actuators pull towards; [T, 3], force (N, N, N m) on these three beside soil and
    # actuators, at the end of the frame; [T, 4, 3], N, as `force`, of the quarters
    target: np.ndarray | None = None
    external: np.ndarray | None = None
    subframe_force: np.ndarray | None = None
    # [T, nx, nz], m, see `height_map`; None in runs of other solvers
    heights: np.ndarray | None = None


def prepared(
    scene: scenes.Scene, case: int | str | Recording, settings: Settings, tool: dict | None = None
) -> Motion:
    """Returns the motion of a run with what the settings say of its soil and tool, checked
    (ValueError: see `catalogue.motion_of` and `checks.check_drive`)."""
    motion = motion_of(scene, case, tool)
    own = {name: getattr(settings, name) for name in motion.ground._fields}
    ground = motion.ground._replace(**{k: v for k, v in own.items() if v is not None})
    body = motion.drive.body
    if settings.tool_friction is not None:
        body = body._replace(friction=settings.tool_friction)
    drive = dataclasses.replace(motion.drive, body=body)
    motion = dataclasses.replace(motion, ground=ground, drive=drive)
    soil, cell = soil_of(motion, settings), min(scene.bin.dx, scene.bin.dz)
    steps = settings.steps or stability.steps_in(settings.exchange, soil, cell)
    per_frame = steps * round(1.0 / (scenes.FRAME_RATE * settings.exchange))
    checks.check_drive(drive, scene.bin, motion.frames, per_frame)
    return motion


def soil_of(motion: Motion, settings: Settings) -> Soil:
    friction = friction_coefficient(motion.ground.friction_angle_deg)
    return make_soil(settings.youngs_modulus, friction, motion.ground.bulk_density)


def make_simulation(
    scene: scenes.Scene, motion: Motion, particles: np.ndarray, settings: Settings
) -> Simulation:
    """Returns the simulation of a motion (`prepared`) on a packing, float64 [N, COLUMNS]."""
    soil, ground = soil_of(motion, settings), motion.ground
    given = scene.bin, motion.drive, soil, particles, settings
    return Simulation(*given, ground.gravity, ground.slope_deg)


def run_case(
    scene: scenes.Scene,
    case: int | str | Recording,
    packed: tuple[np.ndarray, dict],
    settings: Settings,
    on_frame: Callable[[int], None] = lambda frame: None,
    tool: dict | None = None,
) -> RawRun:
    """Simulates one run: T = 321 frames at 60 Hz, or as many as its motion says, the first before
    driving.

    `case` and `tool` are those of `catalogue.motion_of`, `packed` the settled particles and their
    statistics (`packing.settle`); `on_frame` is called with the number of simulated frames, those
    of a lead-in included. ValueError: a body that sinks to the floor, or as `prepared` and
    `Simulation`.
    """
    started = time.process_time()
    motion = prepared(scene, case, settings, tool)
    drive, ground = motion.drive, motion.ground
    heights = HeightMap(scene.bin, packed[0])
    simulation = make_simulation(scene, motion, packed[0], settings)
    seen: list[dict] = []
    deepest: dict[str, float] = {}

    def note(force, torque) -> None:
        seen.append(_seen(scene, motion, simulation, heights, force, torque))
        for name, value in simulation.penetration().items():
            deepest[name] = max(value, deepest.get(name, 0))

    if not drive.lead_in:
        note(np.zeros(3), np.zeros(3))
    for frame in range(1 - drive.lead_in, motion.frames + 1):
        loads = simulation.frame()
        _refuse_sunk(simulation)
        if frame >= 0:
            note(*loads)
        on_frame(frame + drive.lead_in)
    if not drive.lead_in:
        # Nothing is known of the frame that ends at time 0; the first is repeated.
        loads_of = ('force', 'torque', 'subframe_force', 'step_context')
        seen[0] |= {name: seen[1][name] for name in loads_of if name in seen[1]}
    context = zip(scene.context_names, seen[0].get('step_context', ()))
    record = {
        'case': motion.case,
        'split': splits.split_of(scene, motion.case),
        'solver_version': SOLVER_VERSION,
        'data_version': DATA_VERSION,
        'context': {name: float(value) for name, value in context},
        **motion.parameters,
        'friction_angle_deg': ground.friction_angle_deg,
        'bulk_density_kg_m3': ground.bulk_density,
        'gravity_m_s2': ground.gravity,
        **({'slope_deg': ground.slope_deg} if ground.slope_deg else {}),
        **{name: value for name, value in settings.recorded().items() if value is not None},
        'bin_m': list(scene.bin.size),
        'cell_m': [float(side) for side in simulation.grid.cell],
        'time_step_s': simulation.dt,
        'exchange_s': settings.exchange,
        'soil': simulation.soil._asdict(),
        'body_friction': drive.body.friction,
        'body_width_m': 2.0 * drive.body.half_width,
        # The worst frame of the run.
        **{f'penetration_{name}': value for name, value in deepest.items()},
        'packing': packed[1],
        'solver_cpu_s': round(time.process_time() - started, 2),
    }
    arrays = {name: np.array([frame[name] for frame in seen], np.float32) for name in seen[0]}
    return RawRun(parameters=record, **arrays)


def _seen(scene, motion, simulation, heights, force, torque) -> dict:
    machine, now = motion.drive.machine, np.array([simulation.time])
    x, y, theta, z = simulation.pose
    particles = simulation.positions()
    seen = {
        'positions': particles[:: scene.bin.keep_every].astype(np.float32),
        'heights': heights(particles),
        'rigid_positions': bodies.sample_points(motion.drive.body, simulation.pose),
        'force': force,
        'torque': torque,
        'pose': [x, y, z, np.cos(theta / 2), 0.0, 0.0, np.sin(theta / 2)],
    }
    if scene.context_names:
        load = force[1] if machine is None else -machine.force(now)[0, 1]
        ground = motion.ground
        seen['step_context'] = [ground.gravity, ground.friction_angle_deg, load]
    if machine is not None:
        seen |= {'target': simulation.target[:3], 'external': machine.force(now)[0]}
        seen['subframe_force'] = simulation.loads[:, :3]
    return seen


def _refuse_sunk(simulation: Simulation) -> None:
    if not simulation.free.mass.any():
        return
    box, (x, y, theta, _) = simulation.box, simulation.pose
    lowest = y + float(bodies.lowest(simulation.drive.body, np.array(theta)))
    if not lowest > scenes.CORNER:
        raise ValueError(
            f'the body sank to the floor at {simulation.time:.3f} s (lowest point at y = '
            f'{lowest:.4f} m, the floor at {scenes.CORNER} m): {box.size[1]:.4g} m of soil do '
            'not carry it'
        )
    if not scenes.CORNER < x < scenes.CORNER + box.size[0] or lowest > box.surface + box.height:
        raise ValueError(
            f'the body left the bin at {simulation.time:.3f} s (x = {x:.4f} m, lowest point at y = '
            f'{lowest:.4f} m): its load throws it out'
        )
