"""Every run has an id that says how its tool moves; this finds the motion that an id means.

A number is a case of the scene's grid; `lift_0012` is the path of kind `lift` and seed 12; a
`Recording` is the path of a file.
"""

import dataclasses
import math
from dataclasses import dataclass

from mpm import bodies, scenes
from mpm.motions import beyond, grid, machine_drives, operator_paths, wheel_drives
from mpm.motions.drive import Drive
from mpm.motions.recording import Recording, recorded_drive

# Scene -> kind -> what draws a drive and its parameters, those of its own, from scene, kind, seed
# and tool.
_DRAWS = {
    'excavation': dict.fromkeys(operator_paths.KINDS, operator_paths.operator_drive)
    | dict.fromkeys(machine_drives.KINDS, machine_drives.machine_drive)
    | {beyond.KIND: beyond.beyond_drive},
    'wheel': dict.fromkeys(wheel_drives.KINDS, wheel_drives.free_drive)
    | {beyond.KIND: beyond.beyond_drive},
}
KINDS = {scene: tuple(draws) for scene, draws in _DRAWS.items()}
# The kinds that take turns among seeds, where none is named.
TURNS = {'excavation': operator_paths.TURNS, 'wheel': wheel_drives.TURNS}


@dataclass(frozen=True)
class Motion:
    """How the tool moves in one run, and in what soil."""

    case: int | str  # the run's id
    drive: Drive  # the body and its motion
    parameters: dict  # what was drawn or chosen, JSON-compatible; `kind` is among them
    frames: int  # driven frames that are recorded
    ground: scenes.Ground

    @property
    def simulated_frames(self) -> int:
        """Frames that are simulated: those of the lead-in and the recorded ones."""
        return self.drive.lead_in + self.frames


def run_id(case: int | str | Recording) -> int | str:
    return case.case if isinstance(case, Recording) else case


def bin_name(scene: scenes.Scene, case: int | str | Recording) -> str | None:
    """Returns which of the scene's `other_bins` a run needs; None: its own bin."""
    if not isinstance(case, str) or scene.name != 'excavation':
        return None
    return operator_paths.BINS.get(parse(scene, case)[0])


def in_bin(scene: scenes.Scene, case: int | str | Recording) -> scenes.Scene:
    """Returns the scene with the bin that a run needs."""
    if (name := bin_name(scene, case)) is None:
        return scene
    return dataclasses.replace(scene, bin=scene.other_bins[name], other_bins={})


def motion_of(scene: scenes.Scene, case: int | str | Recording, tool: dict | None = None) -> Motion:
    """Returns the motion of a run in the bin of the scene (see `in_bin`), perhaps with another tool
    (`bodies.check_tool`).

    Raises:
        ValueError: there is no such case, kind or seed, or the file is not a path; a tool of the
            other scene.
        FileNotFoundError: there is no such file.
    """
    if tool is not None and ('radius' in tool) != (scene.name == 'wheel'):
        raise ValueError(f'the tool {tool["name"]!r} does not belong into the scene {scene.name!r}')
    usual = scenes.FRAMES - 1
    if isinstance(case, Recording):
        drive, parameters, seconds = recorded_drive(scene, case, tool)
        frames = math.ceil(seconds * scenes.FRAME_RATE - 1e-6)
        ground = scenes.ground_of(scene, parameters)
        return Motion(case.case, drive, parameters, max(frames, usual), ground)
    if isinstance(case, int):
        parameters = {'kind': 'grid', **scene.parameters(case)}
        drive = grid.make_drive(scene, parameters)
        if tool is not None:
            drive = dataclasses.replace(drive, body=bodies.tool_body(tool))
            parameters['tool'] = tool
        return Motion(case, drive, parameters, usual, scenes.ground_of(scene, parameters))
    kind, seed = parse(scene, case)
    drive, drawn = _DRAWS[scene.name][kind](scene, kind, seed, tool)
    parameters = {'kind': kind, 'path_seed': seed, **drawn}
    ground = scenes.ground_of(scene, parameters)._replace(**parameters.pop('ground', {}))
    frames = parameters.pop('frames', usual)
    return Motion(seed_case(kind, seed), drive, parameters, frames, ground)


def seed_case(kind: str, seed: int) -> str:
    return f'{kind}_{seed:04d}'


def parse(scene: scenes.Scene, case: str) -> tuple[str, int]:
    """Returns kind and seed of an id made by `seed_case`; ValueError if the scene has none such."""
    kind, _, seed = case.rpartition('_')
    if kind not in KINDS[scene.name] or not seed.isdecimal():
        raise ValueError(
            f'{scene.name} has no run {case!r}; expected the number of a case (mini, full), or a '
            f'kind of {KINDS[scene.name]} and a seed, such as {seed_case(KINDS[scene.name][0], 12)}'
        )
    return kind, int(seed)


def select_seeds(scene: scenes.Scene, seeds: str, kinds: str | None = None) -> tuple:
    """Returns the ids of the paths of seeds, numbers and ranges such as '3,9000-9009'.

    A seed's kind is kinds[seed % len(kinds)], of kinds separated by commas, by default `TURNS`.
    ValueError: an unknown kind, or seeds that are no numbers or named twice.
    """
    chosen = TURNS[scene.name] if kinds is None else tuple(k.strip() for k in kinds.split(','))
    if unknown := [kind for kind in chosen if kind not in KINDS[scene.name]]:
        raise ValueError(
            f'unknown kinds {unknown} of {scene.name}; there are {", ".join(KINDS[scene.name])}'
        )
    numbers = []
    for part in seeds.split(','):
        first, dash, last = part.strip().partition('-')
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise ValueError(f'seeds must be numbers or ranges such as 9000-9009, got {part!r}')
        span = range(int(first), int(last or first) + 1)
        if not 0 < len(span) <= 100_000:
            raise ValueError(f'seeds {part!r}: a range of {len(span)}, expected 1 to 100000')
        numbers += span
    if len(set(numbers)) < len(numbers):
        raise ValueError(f'a seed is named twice in {seeds!r}')
    return tuple(seed_case(chosen[seed % len(chosen)], seed) for seed in numbers)


def select_runs(scene: scenes.Scene, names: list[str]) -> tuple:
    """Returns the ids of runs that a person names, cases of the grid first: numbers of cases and
    ids of seeds; 'mini' or 'full' alone are the grid in part or whole. ValueError: one that does
    not exist, or that is named twice; none."""
    if names == ['mini']:
        return scene.mini
    if names == ['full']:
        return tuple(range(1, scene.case_count + 1))
    cases = [int(name) for name in names if name.strip().isdecimal()]
    for case in cases:
        scene.parameters(case)
    driven = [seed_case(*parse(scene, name)) for name in names if not name.strip().isdecimal()]
    runs = (*cases, *driven)
    if len(set(runs)) < len(runs) or not runs:
        raise ValueError(f'{",".join(names)!r}: runs were expected, each once')
    return runs
