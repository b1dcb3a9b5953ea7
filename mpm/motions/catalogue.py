"""Every run has an id that says how its tool moves; this finds the motion that an id means.

A number is a case of the scene's grid; `lift_0012` is the path of kind `lift` and seed 12; a
`Recording` is the path of a file.
"""

import math
from dataclasses import dataclass

from mpm import scenes
from mpm.motions import grid, operator_paths, wheel_drives
from mpm.motions.drive import Drive
from mpm.motions.recording import Recording, recorded_drive

KINDS = {'excavation': operator_paths.KINDS, 'wheel': wheel_drives.KINDS}
# The kinds that take turns among seeds, where none is named.
TURNS = {'excavation': operator_paths.TURNS, 'wheel': wheel_drives.KINDS}


@dataclass(frozen=True)
class Motion:
    """How the tool moves in one run.

    Attributes:
        case: the run's id.
        drive: the body and its motion.
        parameters: what was drawn or chosen, JSON-compatible; `kind` is among them.
        frames: driven frames that are recorded.
    """

    case: int | str
    drive: Drive
    parameters: dict
    frames: int

    @property
    def simulated_frames(self) -> int:
        """Frames that are simulated: those of the lead-in and the recorded ones."""
        return self.drive.lead_in + self.frames


def motion_of(scene: scenes.Scene, case: int | str | Recording) -> Motion:
    """Returns the motion of a run.

    Raises:
        ValueError: there is no such case, kind or seed, or the file is not a path.
        FileNotFoundError: there is no such file.
    """
    if isinstance(case, Recording):
        drive, parameters, seconds = recorded_drive(scene, case)
        frames = math.ceil(seconds * scenes.FRAME_RATE - 1e-6)
        return Motion(case.case, drive, parameters, max(frames, scenes.FRAMES - 1))
    if isinstance(case, int):
        parameters = scene.parameters(case)
        drive = grid.make_drive(scene, parameters)
        return Motion(case, drive, {'kind': 'grid', **parameters}, scenes.FRAMES - 1)
    kind, seed = parse(scene, case)
    if scene.name == 'excavation':
        drive, parameters = operator_paths.operator_drive(scene, kind, seed)
    else:
        drive, parameters = wheel_drives.free_drive(scene, kind, seed)
    return Motion(seed_case(kind, seed), drive, parameters, scenes.FRAMES - 1)


def seed_case(kind: str, seed: int) -> str:
    """Returns the id of the path of a kind and a seed."""
    return f'{kind}_{seed:04d}'


def parse(scene: scenes.Scene, case: str) -> tuple[str, int]:
    """Returns kind and seed of an id made by `seed_case`.

    Raises:
        ValueError: if it is none of the scene.
    """
    kind, _, seed = case.rpartition('_')
    if kind not in KINDS[scene.name] or not seed.isdecimal():
        raise ValueError(
            f'{scene.name} has no run {case!r}; expected the number of a case, or a kind of '
            f'{KINDS[scene.name]} and a seed, such as {seed_case(KINDS[scene.name][0], 12)}'
        )
    return kind, int(seed)


def select_seeds(scene: scenes.Scene, seeds: str, kinds: str | None = None) -> tuple:
    """Returns the ids of the paths of some seeds.

    Args:
        scene: the scene.
        seeds: numbers and ranges separated by commas, such as '3,9000-9009'.
        kinds: kinds separated by commas, None: those of `TURNS`. A seed's kind is
            kinds[seed % len(kinds)].

    Raises:
        ValueError: an unknown kind, or seeds that are no numbers or named twice.
    """
    chosen = TURNS[scene.name] if kinds is None else tuple(k.strip() for k in kinds.split(','))
    unknown = [kind for kind in chosen if kind not in KINDS[scene.name]]
    if unknown:
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
    """Returns the ids of runs that a person names: cases of the grid first.

    Raises:
        ValueError: one that does not exist, or that is named twice; none.
    """
    numbers = [name for name in names if name.isdecimal()]
    cases = scenes.select_cases(scene, ','.join(numbers)) if numbers else ()
    driven = [seed_case(*parse(scene, name)) for name in names if name not in numbers]
    if len(set(driven)) < len(driven) or not names:
        raise ValueError(f'{",".join(names)!r}: runs were expected, each once')
    return cases + tuple(driven)
