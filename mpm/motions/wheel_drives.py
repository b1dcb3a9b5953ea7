"""Free drives of the wheel, drawn from a seed: turn, travel and load vary in time.

Turn and travel go from level to level together by quintic pieces (`levels`), each pair of levels
at a slip of its own, and rest at time 0. A drive is a pure function of kind and seed; soil,
gravity, wheel and mean load are drawn from the levels of the grid of cases. Left to the grid is
the small wheel on the Moon: at rest already it sinks through most of the soil.

slip: always forward, speed and slip changing.
stops: one to two halts; at some of them the wheel goes on turning on the spot.
reverse: forward, back, and forward again.
load: as slip, and the load changes between 0.5 and 1.5 times that of the grid (the small wheel's to
    1.0 times below the gravity of the Earth).
"""

import numpy as np

from mpm import bodies, scenes
from mpm.motions import checks, grid
from mpm.motions.drive import Drive
from mpm.motions.levels import Levels
from mpm.motions.operator_paths import STEPS_CHECKED, TRIES

KINDS = ('slip', 'stops', 'reverse', 'load')
MAX_RIM_SPEED = 0.04  # m/s; the grid of cases has 0.0195
SLIPS = (-0.1, 0.9)
LOAD_FACTORS = (0.5, 1.5)
_SMALL = 0.1  # m, diameter
_MOON = 2.0  # m/s2

_FRAMES = scenes.FRAMES
_DURATION = (_FRAMES - 1) / scenes.FRAME_RATE


class _Story:
    """A drive while it is drawn: levels of rim speed and travel (m/s) at common times."""

    def __init__(self, rng):
        self._rng = rng
        self.times, self.rims, self.travels = [0.0], [0.0], [0.0]

    @property
    def time(self) -> float:
        return self.times[-1]

    def go(self, seconds, rim, slip) -> None:
        """Goes to a rim speed (m/s, forward) at a slip in `seconds`."""
        self.times.append(self.time + seconds)
        self.rims.append(rim)
        self.travels.append(rim * (1.0 - slip))

    def roll(self, seconds, direction=1.0) -> None:
        """Goes to a rim speed and slip that are drawn."""
        rim = direction * self._rng.uniform(0.005, MAX_RIM_SPEED)
        self.go(seconds, rim, self._rng.uniform(*SLIPS))


def free_drive(scene: scenes.Scene, kind: str, seed: int) -> tuple[Drive, dict]:
    """Draws a drive.

    Args:
        scene: of the wheel; its grid gives the contexts, its bin limits the travel.
        kind: one of `KINDS`.
        seed: not negative.

    Returns:
        The drive and its parameters, JSON-compatible, those of a case of the grid among them.

    Raises:
        ValueError: an unknown kind, a negative seed, or a bin in which none of `TRIES` fits.
    """
    if kind not in KINDS:
        raise ValueError(f'unknown kind {kind!r} of free drive; there are {KINDS}')
    if seed < 0:
        raise ValueError(f'seed must not be negative, got {seed}')
    rng = np.random.default_rng([seed, KINDS.index(kind), 2])
    context = _draw_context(rng, scene)
    while context['diameter_m'] < _SMALL and context['gravity_m_s2'] < _MOON:
        context = _draw_context(rng, scene)
    for _ in range(TRIES):
        drive, parameters = _draw(rng, scene, kind, context)
        try:
            checks.check_drive(drive, scene.bin, _FRAMES - 1, STEPS_CHECKED)
        except ValueError:
            continue
        return drive, {'kind': kind, 'path_seed': seed, **context, **parameters}
    raise ValueError(f'none of {TRIES} drives of the kind {kind!r}, seed {seed} fits into the bin')


def _draw_context(rng, scene) -> dict:
    return {
        name: values[int(rng.integers(len(values)))]
        for name, values in scene.levels.items()
        if name != 'slip_percent'
    }


def _draw(rng, scene, kind, context) -> tuple[Drive, dict]:
    """One drive, which may leave the bin."""
    story = _Story(rng)
    start_x = grid.WHEEL_START_X - rng.choice([0.0, rng.uniform(0.0, 0.06)])
    {'slip': _slip, 'stops': _stops, 'reverse': _reverse, 'load': _slip}[kind](rng, story)
    rim, travel = (
        Levels(np.array(story.times), np.array(values)) for values in (story.rims, story.travels)
    )
    mean_load = scenes.wheel_load(context)
    factors = np.ones(2)
    times = np.array([0.0, _DURATION])
    if kind == 'load':
        inner = np.sort(rng.uniform(0.15, 0.9, rng.integers(2, 5)))
        times = _DURATION * np.concatenate([[0.0], inner, [1.0]])
        times += np.arange(len(times)) * 0.2  # at least 0.2 s for a change
        low, high = LOAD_FACTORS
        if context['diameter_m'] < _SMALL and context['gravity_m_s2'] < scenes.EARTH_GRAVITY:
            high = 1.0
        factors = np.concatenate([[1.0], rng.uniform(low, high, len(times) - 1)])
    load = Levels(times, mean_load * factors)
    wheel = bodies.make_wheel(context['diameter_m'], scene.bin.z_middle)

    def pose(times):
        x = start_x - travel.integral(times)
        return np.stack([x, np.zeros_like(x), rim.integral(times) / wheel.radius], axis=1)

    shown = np.linspace(0.0, _DURATION, _FRAMES)
    return Drive(wheel, pose, load), {
        'rim_speed_max_m_s': round(float(np.abs(rim(shown)).max()), 6),
        'load_min_N': round(float(load(shown).min()), 4),
        'load_max_N': round(float(load(shown).max()), 4),
    }


def _slip(rng, story) -> None:
    while story.time < _DURATION:
        story.roll(rng.uniform(0.5, 1.5))


def _stops(rng, story) -> None:
    story.roll(rng.uniform(0.4, 0.8))
    for _ in range(rng.integers(1, 3)):
        story.roll(rng.uniform(0.3, 0.8))
        # Halted, or turning on the spot: all slip.
        rim = rng.choice([0.0, rng.uniform(0.005, MAX_RIM_SPEED)])
        story.go(rng.uniform(0.2, 0.5), rim, 1.0)
        story.go(rng.uniform(0.3, 0.8), rim, 1.0)
    _slip(rng, story)


def _reverse(rng, story) -> None:
    story.roll(rng.uniform(0.4, 0.8))
    story.roll(rng.uniform(0.4, 0.9))
    story.go(rng.uniform(0.2, 0.5), 0.0, 0.0)
    story.roll(rng.uniform(0.3, 0.6), -1.0)
    story.roll(rng.uniform(0.4, 0.9), -1.0)
    story.go(rng.uniform(0.2, 0.5), 0.0, 0.0)
    _slip(rng, story)
