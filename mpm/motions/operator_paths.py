"""Paths of the blade as an operator drives it, drawn from a seed.

Speed along the bed, depth and lean go from level to level by quintic pieces (`Levels`), so a path
has a continuous acceleration and rests at time 0. A path is a pure function of kind and seed:

smooth: one cut, or two without leaving the soil, speed, depth and lean varying.
stops: two to three halts of 0.25 to 0.7 s in the soil.
reverse: a cut, back through or over it, and forward again.
lift: a cut, out of the soil, back or on in the air, and a second cut.
disturbed: any of the above on a bed that an earlier pass has cut. That pass is simulated before the
    first recorded frame (`Drive.lead_in`), so the record begins on a bed that is not flat, as live
    use does; the blade rests above the soil at its frame 0.
halts: a smooth path that halts two to four times within one frame and goes on within one, as a
    lever that is let go or a mouse does it.
beside: in a bin twice as wide, a path at a lateral offset of 0 to 1.5 widths from an earlier pass
    of another depth, or between two of them.
soils: any of the first five, in soil of another friction angle, and in some of another density or
    under another gravity.
tools: any of the first five, in the wide bin, with a blade of another width and height or a bucket.
trench: one cut of 1.2 to 1.5 m, in a bin of 2 m.
spread: a short run (`FRAMES`): a cut whose heap is then spread: the blade goes on above the bed.
backdrag: a short run: a cut whose heap is then drawn back: the blade goes over it, is set
    down before it and drags it with its back.
brief: a short run, with a tool and a soil of its own, at any place of the bin: straight down or
    nearly so, then on, deeper, or out and down again.
gravity: as brief, under a gravity between that of the Moon and ten times that of the Earth.
scoop: a bucket cuts, curls about a pin over it, lifts what it holds, and dumps that in one to three
    steps.
buckets: a short run with a bucket of a drawn shape, straight down or nearly so, then on, deeper, or
    out and down again, its floor level or rising; or a scoop.
"""

import math

import numpy as np

from mpm import bodies, scenes
from mpm.motions import checks, grid
from mpm.motions.drive import Drive, Levels, Track, poses

TURNS = ('smooth', 'stops', 'reverse', 'lift', 'disturbed')  # of seeds, if no kind is named
KINDS = (*TURNS, 'halts', 'beside', 'soils', 'tools', 'trench', 'spread', 'backdrag',
         'brief', 'gravity', 'scoop', 'plunge', 'buckets')  # fmt: skip
BRIEF = ('brief', 'gravity')  # with a tool and a soil of their own
DOWN = (*BRIEF, 'plunge')  # straight down somewhere, near walls as well
BINS = {'beside': 'wide', 'tools': 'wide', 'trench': 'long'}  # the others: the scene's own
MAX_DEPTH, MIN_DEPTH = 0.10, 0.01  # m, of the edge below the flat surface
MAX_SPEED = 0.15  # m/s along the bed
MAX_RISE = 0.15  # m/s up or down
MAX_TURN = 60.0  # deg/s
LEANS, STEEP_LEANS = (0.0, 45.0), (25.0, bodies.MAX_LEAN_DEG)  # deg, of a blade
BUCKET_LEANS = (-35.0, 5.0)  # deg, of a bucket of the usual shape: its edge goes in first
# Deg: by which the floor of a given bucket rises behind its edge; least range of its leans.
RELIEF, LEAST_LEANS = 10.0, 20.0
CURLS = (0.0, 60.0)  # deg, of a bucket that lifts what it holds
SCOOP_RADII = (0.07, 0.11)  # m, of its back
PIN = (1.5, 2.5)  # place of the pin over its edge, behind and up, in radii of its back
NARROW_WIDTH = 0.30  # m; the other width is that of the published blade
# Soil that is squeezed against a wall answers with ten times the force of the open field. This room
# stays free in front of the blade, for its heap, and behind it wherever its back pushes soil (as it
# also does when a leaning blade sinks faster than it travels), the depth of the edge added.
FRONT_ROOM, BACK_ROOM = 0.20, 0.12  # m
BACK_DEPTH, BACK_SPEED = 0.02, 0.02  # m, m/s: less is no push
SECOND_CUT_FRAMES = 45
LEAST_REVERSE = 0.02  # m
LONGEST_HALT = 0.8  # s
FARTHEST = 1.5  # widths, between neighbouring cuts
FRICTION_DEG, DENSITY = (28.0, 43.0), (1300.0, 1900.0)  # deg, kg/m3
GRAVITIES = (1.62, 3.72)  # m/s2, Moon and Mars
ANY_GRAVITY = (1.62, 98.1)  # m/s2
TRENCH = (1.2, 1.5)  # m
LAYERS = 0.003, 0.038  # m, of the edge above the bed
LEAST_SPREAD_FRAMES, LEAST_BACKDRAG = 40, 0.12  # m
# Of the other kinds: the scene's own, or `_trench`'s.
FRAMES = {
    'spread': 220, 'backdrag': 290, 'brief': 110, 'gravity': 110, 'scoop': 400, 'plunge': 140,
    'buckets': 150,
}  # fmt: skip
SCOOPS_SHARE, SCOOPS_FRAMES = 0.6, 300  # of `buckets`; the share of those that are tried
# Of drawn tools.
WIDTHS = (0.15, 0.60)  # m
BRIEF_WIDTHS = (0.15, 0.40)  # m, in a bin that is half as wide
DOWN_START = (0.30, 0.82)  # m
BLADE_HEIGHTS = (0.15, 0.40)  # m
EDGE_RADII = (0.008, 0.018)  # m, of blades
BUCKET_RADII = (0.08, 0.16)  # m
# Of `buckets`: radius of the back, length of the floor (m); rise of the floor inside, arc of the
# back (deg); height (m); rise of the underside (deg); least and most by which that is kept.
BACKS, FLOORS, RISES, ARCS = (0.06, 0.14), (0.10, 0.28), (5.0, 35.0), (130.0, 190.0)
BUCKET_HEIGHTS, UNDERSIDES, RELIEFS = (0.17, 0.42), (-5.0, 30.0), np.array([0.0, 40.0])
SHELL = 0.024  # m, thickness of a bucket's shell: several cells, so that no soil leaks through
SHELL_EDGE = 0.004  # m, radius of its edges
PLATE = 0.02  # m, of its side plates: one long cell
SEGMENTS = 7  # of its back

_STEEP_SHARE, _NARROW_SHARE, _ELSEWHERE_SHARE = 0.25, 0.3, 0.5


class _Story(Track):
    """A path while it is drawn: its speed, depth and lean."""

    def __init__(self, rng, depth, lean, leans):
        super().__init__(speed=0.0, depth=depth, lean=lean)
        self.rng, self.leans = rng, leans

    def go(self, seconds, speed, depth=None, lean=None) -> None:
        """Goes to new levels in `seconds`, or as many as their limits of rate need."""
        depth = self.last('depth') if depth is None else depth
        if lean is None:  # a hand never keeps an angle exactly
            low, high = self.leans
            lean = float(np.clip(self.last('lean') + self.rng.uniform(-12.0, 12.0), low, high))
        slowest = max(
            Levels.PEAK * abs(depth - self.last('depth')) / MAX_RISE,
            Levels.PEAK * abs(lean - self.last('lean')) / MAX_TURN,
        )
        self.add(max(seconds, slowest), speed=speed, depth=depth, lean=lean)

    def wait(self, seconds) -> None:
        self.go(seconds, 0.0, lean=self.last('lean'))

    def travel_in_air(self, distance, peak) -> None:
        """Moves by `distance` (m, forward) and stands still again, at most as fast as `peak`."""
        seconds = max(Levels.PEAK * abs(distance) / peak / 2.0, 0.3)
        # From rest up to a speed and down to rest: the mean of both pieces is half the speed.
        self.go(seconds, distance / seconds)
        self.go(seconds, 0.0)

    def way(self) -> float:
        """How far it has gone forward, m."""
        return float(self.levels('speed').integral([self.time])[0])


def operator_drive(
    scene: scenes.Scene, kind: str, seed: int, tool: dict | None = None
) -> tuple[Drive, dict]:
    """Draws a path of one of `KINDS`; without a tool the blade is 0.457 or 0.30 m wide, or drawn.

    Returns the drive and its parameters, JSON-compatible; among them the `ground` where it is not
    the usual one, the `frames` where they are not as usual. ValueError: no path fits the bin, or
    an outline that falls behind its edge.
    """
    rng, limit = np.random.default_rng([seed, KINDS.index(kind), 1]), bodies.MAX_LEAN_DEG
    parameters, leans = {}, BUCKET_LEANS
    if tool is not None and len(tool['outline']) > 2 and kind != 'buckets':
        leans = _relieved(tool)
    # A given one is for the usual soil.
    is_other = kind in ('scoop', 'buckets') and rng.random() < 0.5 and tool is None
    if kind in ('soils', *BRIEF) or is_other:
        parameters['ground'] = _draw_ground(rng, kind)
    if kind in ('tools', *BRIEF) and tool is None:
        tool = _draw_tool(rng, WIDTHS if kind == 'tools' else BRIEF_WIDTHS)
    if kind == 'scoop' and tool is None:
        tool = bucket(rng.uniform(*SCOOP_RADII), rng.uniform(*BRIEF_WIDTHS), rng.random() < 0.7)
    if kind == 'buckets':
        tool = _draw_bucket(rng) if tool is None else tool
        leans = tuple(np.clip(underside(tool) - RELIEFS[::-1], -limit, limit))
    drive, drawn = checks.first_that_fits(
        lambda: _draw(rng, scene, kind, tool, leans), scene.bin, f'{kind!r}, seed {seed}',
        lambda *drawn: _is_fine(scene.bin, *drawn),
    )  # fmt: skip
    if kind != 'trench' and kind not in FRAMES:  # as long as any run
        del drawn['frames']
    return drive, parameters | drawn


def _draw_ground(rng, kind) -> dict:
    if kind == 'gravity':
        gravity = round(math.exp(rng.uniform(*np.log(ANY_GRAVITY))), 3)
        return {'gravity': gravity, 'friction_angle_deg': round(rng.uniform(*FRICTION_DEG), 2)}
    ground, other = {'friction_angle_deg': round(rng.uniform(*FRICTION_DEG), 2)}, rng.random()
    if other < 0.25:
        ground['bulk_density'] = round(rng.uniform(*DENSITY), 1)
    elif other < 0.5:
        ground['gravity'] = float(rng.choice(GRAVITIES))
    return ground


def _draw(rng, scene, kind, tool, bucket_leans) -> tuple[Drive, dict]:
    """One path that keeps all limits but perhaps not the room of the bin; `bucket_leans` (deg) are
    those of a tool with an outline, but where it curls."""
    box = scene.bin
    if tool is not None:
        width = tool['width']
    else:
        width = NARROW_WIDTH if rng.random() < _NARROW_SHARE else bodies.BLADE_WIDTH
        if kind == 'beside':
            width = NARROW_WIDTH if rng.random() < 0.7 else float(rng.choice([0.2, 0.457]))
    body, kept = bodies.blade_or(tool, width)
    leans = STEEP_LEANS if rng.random() < _STEEP_SHARE else LEANS
    if tool is not None and len(tool['outline']) > 2:
        leans = bucket_leans
    clearance, plot = rng.uniform(grid.TIP_CLEARANCE, 0.03), kind
    if kind == 'buckets':
        plot = 'scoop' if rng.random() < SCOOPS_SHARE else 'brief'
    start_x = grid.blade_start(scene)[0]
    if plot in DOWN:
        start_x, clearance = rng.uniform(*DOWN_START), grid.TIP_CLEARANCE
    elif kind != 'trench' and rng.random() < _ELSEWHERE_SHARE:
        start_x = rng.uniform(0.55, start_x + 0.02)
    else:
        clearance = grid.TIP_CLEARANCE
    story = _Story(rng, -clearance, rng.uniform(*leans), leans)
    pin = np.zeros(2)
    if plot == 'scoop':
        # The way that is drawn is that of a pin, told as that of the edge at this lean; the back of
        # a bucket has a radius of 0.42 heights.
        story = _Story(rng, -clearance, rng.uniform(-30.0, -8.0), leans)
        pin = 0.42 * np.ptp(body.outline[:, 1]) * np.array(PIN)
    hung = math.radians(-story.last('lean'))
    if kind in ('soils', 'tools'):
        plot = rng.choice(TURNS)
    offsets, lead_in = [0.0], 0  # across, of each pass, the recorded one last
    if kind == 'beside':
        offsets = _offsets(rng, width)
        kept['offsets_m'] = [round(offset - offsets[-1], 4) for offset in offsets[:-1]]
        plot = 'smooth' if rng.random() < 0.7 else rng.choice(TURNS[:-1])
    elif plot == 'disturbed':
        offsets = [0.0, 0.0]
        plot = rng.choice(TURNS[:-1])
    moves = []
    for _ in offsets[1:]:
        lead_in, move = _earlier_pass(rng, story)
        moves.append(move)
    begin, seconds = story.time, scenes.DURATION
    if kind in FRAMES:
        is_short_scoop = (kind, plot) == ('buckets', 'scoop')
        seconds = (SCOOPS_FRAMES if is_short_scoop else FRAMES[kind]) / scenes.FRAME_RATE
    PLOTS[plot](rng, story, begin + seconds)
    if kind == 'trench':
        seconds = story.time
    speed, depth, lean = (story.levels(name) for name in ('speed', 'depth', 'lean'))
    clock = _halting_clock(rng) if kind == 'halts' else np.asarray
    middle = box.z_middle - 0.5 * (min(offsets) + max(offsets))
    across = _aside(moves, [middle + offset for offset in offsets])

    def pose(times):
        times = clock(times)
        x = start_x - speed.integral(times)
        angle = np.radians(-lean(times))
        if plot == 'scoop':
            x += _turned(pin, hung)[0] - _turned(pin, angle)[0]
            y = box.surface - bodies.lowest(body, np.array(hung)) - depth(times)
            y += _turned(pin, hung)[1] - _turned(pin, angle)[1]
        else:
            y = box.surface - bodies.lowest(body, angle) - depth(times)
        return poses(times, x, y, angle, across(times))

    frames = math.ceil(seconds * scenes.FRAME_RATE - 1e-6)
    shown = clock(begin + np.linspace(0.0, seconds, frames + 1))
    parameters = kept | {
        'plot': str(plot),
        'lead_in_frames': lead_in,
        'frames': frames,
        'depth_max_m': round(float(depth(shown).max()), 6),
        'speed_max_m_s': round(float(np.abs(speed(shown)).max()), 6),
        'lean_min_deg': round(float(lean(shown).min()), 4),
        'lean_max_deg': round(float(lean(shown).max()), 4),
    }
    return Drive(body, pose, lead_in=lead_in), parameters


def _turned(point, angle):
    """x and y of a point [2] turned by angles (rad)."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return cosine * point[0] - sine * point[1], sine * point[0] + cosine * point[1]


def _offsets(rng, width) -> list:
    """Places across (m) of one or two earlier passes and of the recorded one."""
    aside = rng.uniform(0.0, FARTHEST) * width * rng.choice([-1.0, 1.0])
    if rng.random() < 0.75:
        return [0.0, float(aside)]
    other = math.copysign(rng.uniform(0.3, FARTHEST) * width, aside)
    return [0.0, float(aside + other), float(aside)]


def _aside(moves, places):
    """Place across at a time: from one to the next during the moves (begin and end, s)."""
    if not moves:
        return lambda times: np.full(len(np.asarray(times)), places[0])
    times = [t for move in moves for t in move]
    values = [places[0]] + [p for place in places[1:-1] for p in (place, place)] + [places[-1]]
    return Levels(times, values)


def _is_fine(box, drive, parameters) -> bool:
    """Whether the bin has room for the heap as well, and the path shows what it is for."""
    frames, plot = parameters['frames'], parameters['plot']
    times = np.arange(frames + 1 + drive.lead_in) / scenes.FRAME_RATE
    x, y, angle, _ = drive.pose(times).T
    depth = box.surface - y - bodies.lowest(drive.body, angle)
    if plot == 'scoop':  # the heel may press, as that of an excavator does
        has_room = x.min() >= scenes.CORNER + FRONT_ROOM
        return has_room and y.max() <= scenes.CORNER + box.height  # the soil that it holds, too
    if plot in DOWN:
        return x.min() >= scenes.CORNER + FRONT_ROOM / 2
    if x.min() < scenes.CORNER + FRONT_ROOM or _is_squeezing(x, y, angle, depth, box):
        return False
    x, is_below = x[drive.lead_in :], depth[drive.lead_in :] > 0.0
    if plot == 'lift':  # back in the soil for a while
        out = np.flatnonzero(np.diff(is_below.astype(int)) == -1)
        return len(out) > 0 and np.count_nonzero(is_below[out[0] + 1 :]) >= SECOND_CUT_FRAMES  # type: ignore[return-value]
    if plot == 'spread':
        return bool(np.count_nonzero(~is_below[np.argmax(is_below) :]) >= LEAST_SPREAD_FRAMES)
    if plot in ('reverse', 'backdrag'):
        least = LEAST_REVERSE if plot == 'reverse' else LEAST_BACKDRAG
        return float((x - np.minimum.accumulate(x)).max()) >= least
    return True


def _is_squeezing(x, y, angle, depth, box) -> bool:
    """Whether the back of the blade pushes soil against the wall behind it; all [T]."""
    vx, vy = np.gradient(x) * scenes.FRAME_RATE, np.gradient(y) * scenes.FRAME_RATE
    backwards = vx * np.cos(angle) + vy * np.sin(angle)  # speed along the normal of the back
    room = scenes.CORNER + box.size[0] - x
    pushes = (depth > BACK_DEPTH) & (backwards > BACK_SPEED)
    return bool((pushes & (room < BACK_ROOM + depth)).any())


def _cut_depth(rng) -> float:
    return rng.uniform(MIN_DEPTH, MAX_DEPTH)


def _cut_speed(rng) -> float:
    return rng.uniform(0.03, MAX_SPEED)


def _smooth(rng, story, end) -> None:
    story.go(rng.uniform(0.6, 1.2), _cut_speed(rng), _cut_depth(rng))
    while story.time < end - 1.0:
        story.go(rng.uniform(0.6, 1.4), _cut_speed(rng), _cut_depth(rng))
    if rng.random() < 0.5:
        story.go(max(end - story.time, 0.2), rng.uniform(0.0, 0.08), -rng.uniform(0.005, 0.03))
    else:
        story.go(max(end - story.time, 0.2), _cut_speed(rng))


def _stops(rng, story, end) -> None:
    story.go(rng.uniform(0.6, 1.0), _cut_speed(rng), _cut_depth(rng))
    for _ in range(rng.integers(2, 4)):
        depth = _cut_depth(rng) if rng.random() < 0.5 else None
        story.go(rng.uniform(0.3, 0.8), _cut_speed(rng), depth)
        story.go(rng.uniform(0.2, 0.5), 0.0)
        story.wait(rng.uniform(0.25, 0.7))
    story.go(rng.uniform(0.3, 0.7), _cut_speed(rng))
    story.go(max(end - story.time, 0.3), _cut_speed(rng), _cut_depth(rng))


def _reverse(rng, story, end) -> None:
    story.go(rng.uniform(0.6, 1.0), _cut_speed(rng), rng.uniform(MIN_DEPTH, 0.08))
    story.go(rng.uniform(0.5, 1.1), _cut_speed(rng))
    story.go(rng.uniform(0.2, 0.5), 0.0)
    # Back at the same depth, nearer to the surface, or grazing it.
    here = story.last('depth')
    depth = rng.choice([here, rng.uniform(0.3, 0.8) * here, rng.uniform(-0.01, 0.01)])
    story.go(rng.uniform(0.3, 0.6), -rng.uniform(0.03, MAX_SPEED), float(depth))
    story.go(rng.uniform(0.4, 1.0), -rng.uniform(0.03, MAX_SPEED))
    story.go(rng.uniform(0.2, 0.5), 0.0)
    story.go(rng.uniform(0.4, 0.8), _cut_speed(rng), _cut_depth(rng))
    story.go(max(end - story.time, 0.3), _cut_speed(rng))


def _lift(rng, story, end) -> None:
    story.go(rng.uniform(0.5, 0.9), _cut_speed(rng), rng.uniform(0.02, 0.07))
    story.go(rng.uniform(0.3, 0.9), _cut_speed(rng))
    # Out, mostly while the blade slows down; then back over the cut, or on.
    story.go(rng.uniform(0.4, 0.8), rng.uniform(0.0, 0.05), -rng.uniform(0.01, 0.04))
    back = rng.random() < 0.6
    story.go(rng.uniform(0.3, 0.6), rng.uniform(-MAX_SPEED, -0.05) if back else _cut_speed(rng))
    story.go(rng.uniform(0.2, 0.4), 0.0 if back else 0.03)
    story.go(rng.uniform(0.5, 0.8), _cut_speed(rng), rng.uniform(0.02, 0.08))
    story.go(max(end - story.time, 0.3), _cut_speed(rng))


def _spread(rng, story, end) -> None:
    story.go(rng.uniform(0.4, 0.7), rng.uniform(0.11, MAX_SPEED), rng.uniform(0.02, 0.08))
    story.go(rng.uniform(0.3, 0.8), rng.uniform(0.11, MAX_SPEED))
    for _ in range(rng.integers(1, 3)):
        story.go(rng.uniform(0.3, 0.6), rng.uniform(0.08, MAX_SPEED), -rng.uniform(*LAYERS))
        story.go(rng.uniform(0.3, 0.7), rng.uniform(0.11, MAX_SPEED))
    if rng.random() < 0.3:
        story.go(rng.uniform(0.3, 0.6), rng.uniform(0.08, MAX_SPEED), rng.uniform(0.02, 0.06))
    story.go(max(end - story.time, 0.3), rng.uniform(0.11, MAX_SPEED))


def _backdrag(rng, story, end) -> None:
    story.go(rng.uniform(0.3, 0.5), rng.uniform(0.11, MAX_SPEED), rng.uniform(0.02, 0.06))
    story.go(rng.uniform(0.4, 0.8), rng.uniform(0.11, MAX_SPEED))
    # Over the heap or through its crown, and down before it or into it.
    story.go(0.5, rng.uniform(0.05, MAX_SPEED), -rng.uniform(0.02, 0.07))
    story.go(rng.uniform(0.1, 0.5), rng.uniform(0.11, MAX_SPEED))
    story.go(0.3, rng.uniform(0.08, MAX_SPEED), rng.uniform(-0.02, 0.03))
    story.go(rng.uniform(0.3, 0.5), -rng.uniform(0.08, MAX_SPEED))
    depth = rng.uniform(-0.02, 0.03) if rng.random() < 0.5 else None
    story.go(max(end - story.time, 0.3), -rng.uniform(0.08, MAX_SPEED), depth)


def _brief(rng, story, end) -> None:
    is_upright = rng.random() < 0.6
    story.go(rng.uniform(0.2, 0.8), 0.0 if is_upright else _cut_speed(rng), rng.uniform(0.02, 0.08))
    what = rng.choice(['on', 'deeper', 'again'], p=[0.5, 0.25, 0.25])
    if what == 'deeper':
        story.wait(rng.uniform(0.1, 0.3))
        story.go(rng.uniform(0.2, 0.5), 0.0, min(story.last('depth') + 0.03, MAX_DEPTH))
    elif what == 'again':
        story.go(rng.uniform(0.3, 0.5), _cut_speed(rng), -rng.uniform(0.0, 0.02))
        story.go(rng.uniform(0.2, 0.6), 0.0, rng.uniform(0.02, 0.08))
    while story.time < end:
        story.go(rng.uniform(0.2, 0.5), _cut_speed(rng), _cut_depth(rng))


def _plunge(rng, story, end) -> None:
    """Straight down, then any of: a halt, deeper, out and down again at the same place, on."""
    lean = story.last('lean')
    story.go(rng.uniform(0.2, 0.8), 0.0, rng.uniform(0.02, 0.09), lean)
    while story.time < end:
        depth, what = story.last('depth'), rng.choice(['halt', 'deeper', 'again', 'on'])
        if what == 'halt':
            story.wait(rng.uniform(0.1, 0.4))
        elif what == 'deeper':
            depth = min(depth + rng.uniform(0.005, 0.03), MAX_DEPTH)
            story.go(rng.uniform(0.2, 0.5), 0.0, depth, lean)
        elif what == 'again':
            story.go(rng.uniform(0.2, 0.5), 0.0, -rng.uniform(0.0, 0.03), lean)
            depth = float(np.clip(depth + rng.uniform(-0.01, 0.02), MIN_DEPTH, MAX_DEPTH))
            story.go(rng.uniform(0.2, 0.5), 0.0, depth, lean)
        else:
            story.go(rng.uniform(0.2, 0.5), _cut_speed(rng), lean=lean)
            story.go(rng.uniform(0.1, 0.3), 0.0, lean=lean)


def _scoop(rng, story, end) -> None:
    story.go(rng.uniform(0.4, 0.6), 0.05, rng.uniform(0.02, 0.06), story.last('lean'))
    story.go(rng.uniform(0.8, 1.8), rng.uniform(0.08, MAX_SPEED), lean=story.last('lean'))
    curl = rng.uniform(*CURLS)
    # In the soil, or while it lifts.
    if rng.random() < 0.5:
        story.go(rng.uniform(0.3, 0.6), 0.03, lean=rng.uniform(story.last('lean'), curl))
    story.go(rng.uniform(0.4, 0.8), 0.0, -rng.uniform(0.04, 0.08), curl)
    story.go(rng.uniform(0.2, 0.5), rng.uniform(-0.08, 0.08), lean=curl)
    story.wait(0.2)
    for share in sorted(rng.random(rng.integers(0, 3)), reverse=True):
        story.go(0.3, 0.0, lean=-40.0 + share * (curl + 40.0))
        story.wait(rng.uniform(0.2, 0.5))
    story.go(max(end - 0.5 - story.time, 0.3), 0.0, lean=-40.0)


def _trench(rng, story, end) -> None:
    """One long cut of changing speed and depth, as long as it takes."""
    story.go(rng.uniform(0.6, 1.0), _cut_speed(rng), rng.uniform(0.02, 0.06))
    length = rng.uniform(*TRENCH)
    while story.way() < length - 0.1:
        story.go(rng.uniform(0.8, 1.6), rng.uniform(0.08, MAX_SPEED), rng.uniform(0.02, 0.07))
    story.go(0.6, 0.03, -0.01)


# What draws a path that ends at some time (s), by plot.
PLOTS = {
    'smooth': _smooth, 'halts': _smooth, 'stops': _stops, 'reverse': _reverse, 'lift': _lift,
    'spread': _spread, 'backdrag': _backdrag, 'brief': _brief, 'gravity': _brief,
    'trench': _trench, 'scoop': _scoop, 'plunge': _plunge,
}  # fmt: skip


def _halting_clock(rng):
    """Draws a clock that stands for a while now and then: times [T] (s) of a run to its path's."""
    frame = 1.0 / scenes.FRAME_RATE
    times, rates, time = [0.0], [1.0], rng.uniform(0.8, 1.6)
    for _ in range(rng.integers(2, 5)):
        halt = rng.uniform(0.2, LONGEST_HALT)
        times += [time, time + frame, time + frame + halt, time + 2 * frame + halt]
        rates += [1.0, 0.0, 0.0, 1.0]
        time = times[-1] + rng.uniform(0.4, 1.0)
    return Levels(times, rates).integral


def _earlier_pass(rng, story) -> tuple[int, tuple]:
    """Adds a quick first pass, the way back through the air, and a pause above the soil; the next
    path starts within 12 cm of the place where this pass started. Returns the frames until it is
    over, and when the blade is on its way in the air (s)."""
    clearance = -story.last('depth')
    speed = rng.uniform(0.10, MAX_SPEED)
    story.go(rng.uniform(0.5, 0.7), speed, rng.uniform(0.02, 0.07))
    story.go(rng.uniform(0.7, 1.4), speed)
    story.go(rng.uniform(0.4, 0.6), 0.05, -clearance - 0.02)
    story.go(0.3, 0.0)
    leaves = story.time
    story.travel_in_air(-story.way() + rng.uniform(-0.02, 0.12), 0.5)
    # A way across may be longer than that along.
    story.wait(0.3)
    moves = leaves, story.time
    story.go(0.3, 0.0, -clearance)
    story.wait(0.25)
    # The pause ends on a frame.
    frames = math.ceil(story.time * scenes.FRAME_RATE - 1e-9)
    story.times[-1] = frames / scenes.FRAME_RATE
    return frames, moves


def _draw_tool(rng, widths) -> dict:
    """A tool (`bodies.check_tool`): three blades to two buckets."""
    width = round(rng.uniform(*widths), 3)
    if rng.random() >= 0.6:
        return bucket(rng.uniform(*BUCKET_RADII), width, rng.random() < 0.5)
    radius = round(rng.uniform(*EDGE_RADII), 4)
    height = round(rng.uniform(*BLADE_HEIGHTS), 3)
    outline = [[0.0, 0.0], [0.0, height - 2 * radius]]
    tool = {'name': 'blade', 'outline': outline, 'edge_radius': radius, 'width': width}
    return bodies.check_tool(tool)


def _draw_bucket(rng) -> dict:
    """A bucket of a shape of its own."""
    width, has_plates = rng.uniform(*BRIEF_WIDTHS), rng.random() < 0.7
    while True:
        radius, *shape = (rng.uniform(*limits) for limits in (BACKS, FLOORS, RISES, ARCS))
        tool = bucket(radius, width, has_plates, *shape)
        height = max(y for _, y in tool['outline'])
        is_usual = BUCKET_HEIGHTS[0] <= height <= BUCKET_HEIGHTS[1]
        if is_usual and UNDERSIDES[0] <= underside(tool) <= UNDERSIDES[1]:
            return tool


def underside(tool: dict) -> float:
    """Deg by which all that lies behind the edge of a tool with an outline rises at least."""
    behind = (point for point in tool['outline'] if point[0] > tool['edge_radius'])
    return min((math.degrees(math.atan2(y, x)) for x, y in behind), default=90.0)


def _relieved(tool: dict) -> tuple[float, float]:
    """Leans (deg) at which all that lies behind the edge of a tool with an outline rises by
    `RELIEF`: a floor that falls bears on soil that the edge has not cut. ValueError: there are
    none."""
    rise, (low, high) = underside(tool), BUCKET_LEANS
    high = min(high, rise - RELIEF)
    if high - LEAST_LEANS < -bodies.MAX_LEAN_DEG:
        raise ValueError(
            f'the outline of {tool["name"]!r} falls by {-rise:.3g} deg behind its edge, the '
            f'origin; turn it about that, until its floor rises'
        )
    return min(low, high - LEAST_LEANS), high


def bucket(
    radius: float, width: float, has_plates: bool, floor: float | None = None,
    rise_deg: float = 15.0, arc_deg: float = 165.0,
) -> dict:  # fmt: skip
    """Returns a bucket of an inner `radius` (m) and a width (m) that opens towards -x; its edge is
    the reference point. A flat `floor` (m; without one 1.6 radii) rises behind the edge and goes
    over into an arc; its ends may be closed by plates."""
    rise = math.radians(rise_deg)
    along = np.array([math.cos(rise), math.sin(rise)])
    normal = np.array([-along[1], along[0]])
    start = (1.6 * radius if floor is None else floor) * along
    middle = start + radius * normal
    turn = rise - math.pi / 2 + np.linspace(0.0, math.radians(arc_deg), SEGMENTS + 1)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    inner, outer = middle + radius * ring, middle + (radius + SHELL) * ring
    # The floor tapers towards the edge.
    below, above = start - SHELL * normal, 0.3 * SHELL * normal
    outline = np.concatenate([[[0.0, 0.0], below], outer[1:], inner[::-1], [above]])
    tool = {
        'name': 'bucket',
        'outline': np.round(outline, 5).tolist(),
        'edge_radius': SHELL_EDGE,
        'width': round(width, 3),
    }
    if has_plates:
        tool['side_plates'] = {'thickness': PLATE}
    return bodies.check_tool(tool)
