"""One run: from the settled packing to the arrays of a raw run."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mpm import scenes, splits, stability, versions
from mpm.constitutive import Soil, make_soil
from mpm.motions import checks, grid
from mpm.motions.catalogue import Motion, motion_of
from mpm.motions.recording import Recording
from mpm.simulation import Settings, Simulation


@dataclass(frozen=True)
class RawRun:
    """The arrays of one run, as written to disk.

    Attributes:
        positions: float32 [T, N, 3], m.
        rigid_positions: float32 [T, R, 3], m.
        force: float32 [T, 3], N, on the body by the soil, mean over the frame that ends at t.
        parameters: what was run, JSON-compatible.
        torque: float32 [T, 3], N m, about the body's reference point, as the force; None in runs of
            before version 2.
        pose: float32 [T, 7], position (m) of the reference point and unit quaternion (w, x, y, z)
            that turns the upright body; None in runs of before version 2.
        step_context: float32 [T, C], values of the scene's `context_names` at each frame (the load
            may vary); None if it has none, or in runs of before version 2.
    """

    positions: np.ndarray
    rigid_positions: np.ndarray
    force: np.ndarray
    parameters: dict
    torque: np.ndarray | None = None
    pose: np.ndarray | None = None
    step_context: np.ndarray | None = None


def check_motion(scene: scenes.Scene, motion: Motion, settings: Settings) -> None:
    """Refuses a motion that the bin or the time step does not allow, before anything is simulated.

    Raises:
        ValueError: see `checks.check_drive`.
    """
    _check_drive(
        scene, motion.drive, motion.frames, soil_of(scene, motion.parameters, settings), settings
    )


def _check_drive(scene, drive, frames, soil, settings) -> None:
    steps = settings.steps_per_frame or stability.steps_per_frame(
        1 / scenes.FRAME_RATE, soil, scene.bin.dx, settings.rheology == 'nonlocal'
    )
    checks.check_drive(drive, scene.bin, frames, steps)


def soil_of(scene: scenes.Scene, parameters: dict, settings: Settings) -> Soil:
    """Returns the soil of a run."""
    friction = scenes.static_friction(scene, parameters)
    return make_soil(settings.youngs_modulus, friction, dilation=settings.dilation)


def make_simulation(
    scene: scenes.Scene, parameters: dict, soil: Soil, particles: np.ndarray, settings: Settings
) -> Simulation:
    """Returns the simulation of a case of the grid, ready for its first frame.

    Args:
        scene: the scene.
        parameters: of the case, by name (`Scene.parameters`).
        soil: of the bin.
        particles: float64 [N, COLUMNS], the settled packing.
        settings: stiffness, law, steps.

    Raises:
        ValueError: see `checks.check_drive` and `Simulation`.
    """
    drive = grid.make_drive(scene, parameters)
    _check_drive(scene, drive, scenes.FRAMES - 1, soil, settings)
    gravity = scenes.gravity_of(scene, parameters)
    return Simulation(scene.bin, drive, soil, particles, settings, gravity)


def run_case(
    scene: scenes.Scene,
    case: int | str | Recording,
    packed: tuple[np.ndarray, dict],
    settings: Settings,
    on_frame: Callable[[int], None] | None = None,
) -> RawRun:
    """Simulates one run.

    Args:
        scene: the scene.
        case: what to run, see `catalogue.motion_of`.
        packed: the settled particles and their statistics (`packing.settle`).
        settings: stiffness, law, seed.
        on_frame: called with the number of simulated frames, those of a lead-in included.

    Returns:
        The run: T = 321 frames at 60 Hz (more for a longer recording), the first before driving.

    Raises:
        ValueError: a wheel that sinks to the floor; see also `catalogue.motion_of`,
            `checks.check_drive` and `Simulation`.
    """
    started = time.process_time()
    motion = motion_of(scene, case)
    check_motion(scene, motion, settings)
    parameters, drive = motion.parameters, motion.drive
    context = scenes.context_of(scene, parameters)
    soil = soil_of(scene, parameters, settings)
    gravity = scenes.gravity_of(scene, parameters)
    simulation = Simulation(scene.bin, drive, soil, packed[0], settings, gravity)
    kept = slice(None, None, scene.bin.keep_every)
    frames: dict[str, list] = {
        'positions': [],
        'rigid_positions': [],
        'pose': [],
        'step_context': [],
    }
    force, torque = [], []
    deepest: dict[str, float] = {}

    def note() -> None:
        frames['positions'].append(simulation.positions()[kept].astype(np.float32))
        frames['rigid_positions'].append(simulation.rigid_points())
        frames['pose'].append(quaternion_pose(*simulation.pose, drive.body.z_middle))
        if context:
            load = float(drive.load(np.array([simulation.time]))[0])
            frames['step_context'].append(list((context | {'load': load}).values()))
        for name, value in simulation.penetration().items():
            deepest[name] = max(value, deepest.get(name, 0))

    if not drive.lead_in:
        note()
    for frame in range(1 - drive.lead_in, motion.frames + 1):
        result = simulation.frame()
        _refuse_sunk(simulation, scene.bin)
        if frame >= 0:
            force.append(result[0])
            torque.append(result[1])
            note()
        if on_frame is not None:
            on_frame(frame + drive.lead_in)
    # Without a lead-in nothing is known of the frame that ends at time 0; the first is repeated.
    first = slice(0, 0 if drive.lead_in else 1)
    arrays = frames | {'force': force[first] + force, 'torque': torque[first] + torque}
    record = {
        'case': motion.case,
        'split': splits.split_of(scene, motion.case),
        'solver_version': versions.SOLVER_VERSION,
        'data_version': versions.DATA_VERSION,
        'context': context,
        **parameters,
        **{name: value for name, value in settings.recorded().items() if value is not None},
        'time_step_s': simulation.dt,
        'cell_size_m': simulation.grid.dx,
        'soil': {n: v for n, v in soil._asdict().items() if n != 'dilation' or v},
        'body_friction': drive.body.friction,
        # The worst frame of the run.
        **{f'penetration_{name}': value for name, value in deepest.items()},
        'packing': packed[1],
        'solver_cpu_s': round(time.process_time() - started, 2),
    }
    return RawRun(
        parameters=record,
        **{name: np.asarray(a, dtype=np.float32) for name, a in arrays.items() if len(a)},
    )


def _refuse_sunk(simulation: Simulation, box: scenes.Bin) -> None:
    """Raises if a body that rides freely has sunk to the floor of the bin."""
    drive = simulation.drive
    lowest = simulation.pose[1] - drive.body.radius
    if drive.load is not None and not lowest > scenes.CORNER:
        raise ValueError(
            f'the wheel sank to the floor at {simulation.time:.3f} s (lowest point at y = '
            f'{lowest:.4f} m, the floor at {scenes.CORNER} m): {box.size[1]:.4g} m of soil do '
            'not carry it'
        )


def quaternion_pose(x: float, y: float, theta: float, z: float) -> np.ndarray:
    """Returns a pose in the plane as float64 [7]: x, y, z (m), quaternion w, x, y, z."""
    return np.array([x, y, z, np.cos(theta / 2), 0.0, 0.0, np.sin(theta / 2)])
