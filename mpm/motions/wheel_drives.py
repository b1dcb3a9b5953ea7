"""Free drives of the wheel, drawn from a seed: turn, travel and load vary in time.

Turn and travel go from level to level together by quintic pieces (`Levels`), each pair of levels
at a slip of its own, and rest at time 0. A drive is a pure function of kind and seed; soil,
gravity, wheel and mean load are drawn from the levels of the grid of cases. Left to the grid is
the small wheel on the Moon: at rest already it sinks through most of the soil.

slip: always forward, speed and slip changing.
stops: one to two halts; at some of them the wheel goes on turning on the spot.
reverse: forward, back, and forward again.
load: as slip, and the load changes between 0.5 and 1.5 times that of the grid (the small wheel's to
    1.0 times below the gravity of the Earth).
height: as slip or reverse, and the height is the vehicle's: it sinks, bobs and climbs its own rut.
wheels: any of the first four, with a wheel of another radius and width, in soil of another friction
    angle; the load is in proportion to the wheel's size.
grousers: as slip, with a wheel that has grousers.
brief: `BRIEF` frames of wheels, grousers or height, with a wheel and soil of its own: what differs
    from wheel to wheel and soil to soil teaches more than a longer drive of one.
rut: `BRIEF` frames in, out of or across the rut of an earlier pass (a lead-in, as of `disturbed` in
    `operator_paths`) of the same wheel, with a wheel and soil of its own, at a given height.
tow: as brief, most with grousers, about where a wheel neither pulls nor brakes: one of a vehicle
    on its way slips by a little less or more than nothing.
"""

from functools import partial

import numpy as np

from mpm import bodies, scenes
from mpm.motions import checks, grid
from mpm.motions.drive import Drive, Levels, Track, poses, under_load

TURNS = ('slip', 'stops', 'reverse', 'load')  # of seeds, if no kind is named
KINDS = (*TURNS, 'height', 'wheels', 'grousers', 'brief', 'rut', 'tow')
OWN = ('wheels', 'grousers', 'brief', 'rut', 'tow')  # kinds that draw a wheel and a soil
BRIEF = 100  # frames
MAX_RIM_SPEED = 0.04  # m/s; the grid of cases has 0.0195
SLIPS, TOW_SLIPS = (-0.1, 0.9), (-0.3, 0.15)
GROUSERS_SHARE = {'grousers': 1.0, 'brief': 0.4, 'rut': 0.4, 'tow': 0.75}  # of the runs of a kind
LOAD_FACTORS = (0.5, 1.5)
RADII, WIDTHS, FRICTION_DEG = (0.03, 0.15), (0.05, 0.125), (28.0, 43.0)  # m, m, deg
SMALLEST_WITH_GROUSERS = {'tow': 0.05}  # m, radius; the other kinds: 0.07
GROUSERS = {'count': (8, 25), 'height': (0.005, 0.015), 'thickness': (0.005, 0.009)}
PRESSURE = (3.0e3, 12.0e3)  # Pa, load over diameter and width, of drawn wheels on the Earth
SINKAGE = (-0.1, 0.12)  # of the radius, of a wheel at a given height
# m, below and above where it touches the soil: at most, and at first.
DEEPEST, HIGHEST, ABOVE = 0.012, 0.01, 0.004
# Of a rut: depth, of the radius and at most, m; speed (m/s) and slip of the pass that leaves it;
# its way, m; how far back the wheel is set down, of that way; height of its way back, m.
RUTS, DEEPEST_RUT, RUT_SPEED, RUT_SLIPS = (0.02, 0.12), 0.008, 0.1, (-0.05, 0.5)
RUT_WAYS, RUT_BACK, RUT_UP, LIFT = (0.05, 0.12), (0.1, 1.1), 0.002, 0.03
_SMALL = 0.1  # m, diameter
_MOON = 2.0  # m/s2


class _Story(Track):
    """A drive while it is drawn: its rim speed and travel, m/s."""

    def __init__(self, rng, slowest, slips):
        super().__init__(rim=0.0, travel=0.0)
        self._rng, self._slowest, self._slips = rng, slowest, slips

    def go(self, seconds, rim, slip) -> None:
        """Goes to a rim speed (m/s, forward) at a slip in `seconds`."""
        self.add(seconds, rim=rim, travel=rim * (1.0 - slip))

    def roll(self, seconds, direction=1.0) -> None:
        """Goes to a rim speed and slip that are drawn."""
        rim = direction * self._rng.uniform(self._slowest, MAX_RIM_SPEED)
        self.go(seconds, rim, self._rng.uniform(*self._slips))


def free_drive(
    scene: scenes.Scene, kind: str, seed: int, tool: dict | None = None
) -> tuple[Drive, dict]:
    """Draws a drive of one of `KINDS`; without a tool the wheel is one of the grid, or drawn.

    Returns the drive and its parameters, JSON-compatible, those of a case of the grid among them.
    ValueError: no drive fits the bin.
    """
    rng = np.random.default_rng([seed, KINDS.index(kind), 2])
    context: dict = {}
    while not context or context['diameter_m'] < _SMALL and context['gravity_m_s2'] < _MOON:
        context = {
            name: values[int(rng.integers(len(values)))]
            for name, values in scene.levels.items()
            if name != 'slip_percent'
        }
    load = scenes.wheel_load(context)
    if kind in OWN or tool is not None:
        tool = tool or _draw_wheel(rng, kind)
        context['diameter_m'] = round(2.0 * tool['radius'], 6)
        context['friction_angle_deg'] = round(rng.uniform(*FRICTION_DEG), 2)
        pressure = rng.uniform(*PRESSURE) * context['gravity_m_s2'] / scenes.EARTH_GRAVITY
        load = round(pressure * 2.0 * tool['radius'] * tool['width'], 3)
        context |= {'load_N': load, 'tool': tool}
        wheel = bodies.tool_body(tool)
    else:
        wheel = bodies.make_wheel(context['diameter_m'])
    drive, drawn = checks.first_that_fits(
        lambda: _draw(rng, scene, kind, wheel, load, context), scene.bin, f'{kind!r}, seed {seed}'
    )
    return drive, context | drawn


def _draw_wheel(rng, kind) -> dict:
    share = GROUSERS_SHARE.get(kind, 0.0)
    has_grousers = share == 1.0 or share > 0.0 and rng.random() < share
    smallest = SMALLEST_WITH_GROUSERS.get(kind, 0.07) if has_grousers else RADII[0]
    radius = rng.uniform(smallest, RADII[1])
    tool = {'name': 'wheel', 'radius': round(radius, 4), 'width': round(rng.uniform(*WIDTHS), 4)}
    if has_grousers:
        height = min(rng.uniform(*GROUSERS['height']), 0.15 * radius)
        tool['grousers'] = {
            'count': int(rng.integers(*GROUSERS['count'])),
            'height': round(height, 4),
            'thickness': round(rng.uniform(*GROUSERS['thickness']), 4),
        }
    return bodies.check_tool(tool)


def _draw(rng, scene, kind, wheel, mean_load, context) -> tuple[Drive, dict]:
    is_short = kind in ('brief', 'rut', 'tow')
    slips = TOW_SLIPS if kind == 'tow' else SLIPS
    box, story = scene.bin, _Story(rng, 0.02 if is_short else 0.005, slips)
    seconds = BRIEF / scenes.FRAME_RATE if is_short else scenes.DURATION
    frames = round(seconds * scenes.FRAME_RATE)
    start_x = grid.WHEEL_START_X - rng.choice([0.0, rng.uniform(0.0, 0.06)])
    plot, at_height = kind, kind in ('height', 'rut')
    if kind in ('brief', 'tow'):
        plot, at_height = str(rng.choice(('slip', 'load'))), rng.random() < 0.5
    elif kind == 'wheels':
        plot = str(rng.choice(TURNS))
    elif kind == 'height':
        plot = 'reverse' if rng.random() < 0.4 else 'slip'
    base, before = box.surface + wheel.reach, Levels([-1.0, 0.0], [0.0, 0.0])
    if kind == 'rut':
        plot = 'back' if rng.random() < 0.25 else 'slip'
        base, before = _leave_a_rut(rng, story, wheel, base, plot == 'back')
    begin = story.time
    draw = {'stops': _stops, 'reverse': _reverse, 'back': partial(_slip, direction=-1.0)}
    draw.get(plot, _slip)(rng, story, begin + seconds)
    rim, travel = story.levels('rim'), story.levels('travel')
    shown = begin + np.linspace(0.0, seconds, frames + 1)
    parameters = {'plot': plot, 'rim_speed_max_m_s': round(float(np.abs(rim(shown)).max()), 6)}
    machine, height = None, None
    if at_height:
        height = _bobbing(rng, base, wheel, seconds, RUT_UP if kind == 'rut' else HIGHEST)
    else:
        factors, times = np.ones(2), np.array([0.0, seconds])
        if plot == 'load':
            inner = np.sort(rng.uniform(0.15, 0.9, rng.integers(2, 5)))
            times = seconds * np.concatenate([[0.0], inner, [1.0]])
            times += np.arange(len(times)) * 0.2  # at least 0.2 s for a change
            low, high = LOAD_FACTORS
            if context['diameter_m'] < _SMALL and context['gravity_m_s2'] < scenes.EARTH_GRAVITY:
                high = 1.0
            factors = np.concatenate([[1.0], rng.uniform(low, high, len(times) - 1)])
        load = Levels(times, mean_load * factors)
        machine = under_load(load)
        parameters['load_min_N'] = round(float(load(shown).min()), 4)
        parameters['load_max_N'] = round(float(load(shown).max()), 4)

    def pose(times):
        x = start_x - travel.integral(times)
        y = 0.0 if height is None else np.where(times < begin, before(times), height(times - begin))
        turn = rim.integral(times) / wheel.radius
        return poses(times, x, y, turn, box.z_middle)

    rest = 0 if machine is None else grid.REST_FRAMES
    if is_short:
        parameters['frames'] = frames
    if lead_in := round(begin * scenes.FRAME_RATE):
        parameters['lead_in_frames'] = lead_in
    return Drive(wheel, pose, machine, lead_in, rest), parameters


def _leave_a_rut(rng, story, wheel, base, stays) -> tuple[float, Levels]:
    """Adds a pass that leaves a rut, and a way back in the air unless it `stays`; about where the
    wheel will touch the soil again (m), and the height of the axle until it is over that."""
    depth = min(rng.uniform(*RUTS) * wheel.radius, DEEPEST_RUT)
    way, slip = rng.uniform(*RUT_WAYS), rng.uniform(*RUT_SLIPS)
    up, down = base + LIFT, base - depth
    times, heights = [0.0, 0.2], [base + 0.002, down]
    story.add(0.2)
    rim = RUT_SPEED / (1.0 - slip)
    for seconds, to in ((0.2, rim), (max(way / RUT_SPEED - 0.2, 0.1), rim), (0.2, 0.0)):
        story.go(seconds, to, slip)
        times.append(story.time)
        heights.append(base - min(rng.uniform(0.7, 1.3) * depth, DEEPEST_RUT))
    story.add(0.2)
    times.append(story.time)
    heights.append(up)
    back = 0.0 if stays else rng.uniform(*RUT_BACK) * way
    for speed in (-back / 0.3, 0.0):
        story.add(0.3, travel=speed)
    # To the beginning of a frame, and over the soil again.
    story.add(0.2 - (story.time * scenes.FRAME_RATE % 1.0 - 1.0) / scenes.FRAME_RATE)
    times += [story.time - 0.2, story.time]
    again = base - rng.uniform(0.3, 1.0) * depth
    return again, Levels(times, [*heights, up, again + ABOVE])


def _bobbing(rng, base, wheel, seconds, up) -> Levels:
    """Height of the axle over time, from above the soil (which it touches at the height `base`)
    down, and up by at most `up`, and down again."""

    def sinkage():
        return min(rng.uniform(*SINKAGE) * wheel.radius, DEEPEST)

    times = [0.0, 0.1, rng.uniform(0.5, 1.2) * min(seconds / 3.0, 1.0)]
    heights = [base + ABOVE, base + ABOVE, base - min(abs(sinkage()), DEEPEST)]
    while times[-1] < seconds:
        times.append(times[-1] + rng.uniform(0.15, 1.2))
        is_step = rng.random() < 0.6
        height = heights[-1] + rng.uniform(-0.004, 0.004) if is_step else base - sinkage()
        heights.append(float(np.clip(height, base - DEEPEST, base + up)))
    return Levels(times, heights)


def _slip(rng, story, seconds, direction=1.0) -> None:
    while story.time < seconds:
        story.roll(rng.uniform(0.5, 1.5) * min(seconds / 3.0, 1.0), direction)


def _stops(rng, story, seconds) -> None:
    story.roll(rng.uniform(0.4, 0.8))
    for _ in range(rng.integers(1, 3)):
        story.roll(rng.uniform(0.3, 0.8))
        # Halted, or turning on the spot: all slip.
        rim = rng.choice([0.0, rng.uniform(0.005, MAX_RIM_SPEED)])
        story.go(rng.uniform(0.2, 0.5), rim, 1.0)
        story.go(rng.uniform(0.3, 0.8), rim, 1.0)
    _slip(rng, story, seconds)


def _reverse(rng, story, seconds) -> None:
    story.roll(rng.uniform(0.4, 0.8))
    story.roll(rng.uniform(0.4, 0.9))
    story.go(rng.uniform(0.2, 0.5), 0.0, 0.0)
    story.roll(rng.uniform(0.3, 0.6), -1.0)
    story.roll(rng.uniform(0.4, 0.9), -1.0)
    story.go(rng.uniform(0.2, 0.5), 0.0, 0.0)
    _slip(rng, story, seconds)
