"""One run of a case: from the settled packing to the arrays of a raw run."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mpm import scenes
from mpm.constitutive import Soil, make_soil
from mpm.motions import grid
from mpm.simulation import Settings, Simulation


@dataclass(frozen=True)
class RawRun:
    """The arrays of one run, as written to disk.

    Attributes:
        positions: float32 [T, N, 3], m.
        rigid_positions: float32 [T, R, 3], m.
        force: float32 [T, 3], N, on the body by the soil, mean over the frame that ends at t.
        parameters: what was run, JSON-compatible.
    """

    positions: np.ndarray
    rigid_positions: np.ndarray
    force: np.ndarray
    parameters: dict


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
        ValueError: see `Simulation`.
    """
    return Simulation(
        scene.bin,
        grid.make_drive(scene, parameters),
        soil,
        particles,
        settings,
        scenes.gravity_of(scene, parameters),
    )


def run_case(
    scene: scenes.Scene,
    case: int,
    packed: tuple[np.ndarray, dict],
    settings: Settings,
    on_frame: Callable[[int], None] | None = None,
) -> RawRun:
    """Simulates one case.

    Args:
        scene: the scene.
        case: its number.
        packed: the settled particles and their statistics (`packing.settle`).
        settings: stiffness, law, seed.
        on_frame: called with the number of each finished frame.

    Returns:
        The run: T = 321 frames at 60 Hz, the first before driving.

    Raises:
        ValueError: see `Simulation`.
    """
    started = time.process_time()
    parameters = scene.parameters(case)
    soil = make_soil(settings.youngs_modulus, scenes.static_friction(scene, parameters))
    simulation = make_simulation(scene, parameters, soil, packed[0], settings)
    kept = slice(None, None, scene.bin.keep_every)
    positions = [simulation.positions()[kept].astype(np.float32)]
    rigid = [simulation.rigid_points()]
    force = []
    for frame in range(1, scenes.FRAMES):
        force.append(simulation.frame()[0])
        positions.append(simulation.positions()[kept].astype(np.float32))
        rigid.append(simulation.rigid_points())
        if on_frame is not None:
            on_frame(frame)
    record = {
        'case': case,
        'seed': settings.seed,
        'context': scenes.context_of(scene, parameters),
        **parameters,
        'youngs_modulus_Pa': settings.youngs_modulus,
        'rheology': settings.rheology,
        'time_step_s': simulation.dt,
        'cell_size_m': simulation.grid.dx,
        'soil': soil._asdict(),
        'body_friction': simulation.drive.body.friction,
        'packing': packed[1],
        'solver_cpu_s': round(time.process_time() - started, 2),
    }
    return RawRun(
        positions=np.asarray(positions, dtype=np.float32),
        rigid_positions=np.asarray(rigid, dtype=np.float32),
        force=np.asarray(force[:1] + force, dtype=np.float32),
        parameters=record,
    )
