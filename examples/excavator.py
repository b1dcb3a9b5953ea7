"""An excavator in MuJoCo digs a trench, lifts, dumps, and comes back for a second cut beside it.

    python examples/excavator.py dig.mp4

Swing and three joints are moved by position servos; the weights of the arm are borne, as hydraulics
bear them. The bucket goes along a path of its edge; how far it lags is what the soil does to it.
The bucket curls in the soil, so that some of it stays on its floor, weighs on the arm and is poured
out beside the trench; the terrain and the bucket together keep the volume.
"""

import pathlib
import sys
import time

import mujoco
import numpy as np

import learning_to_simulate as lts
from learning_to_simulate.mujoco_soil import MujocoSoil, add_height_field

FOLDER = pathlib.Path(__file__).parent
sys.path.insert(0, str(FOLDER))
from film import Film  # noqa: E402

PIVOT, BOOM, STICK, BUCKET = 0.75, 1.35, 0.95, 0.3  # m: height of the boom's pin, lengths
# Time (s), and where the edge is then: distance from the pin of the boom, height (m), lean (rad).
CUT = (
    (0.0, 2.15, 0.20, -0.45), (1.2, 2.15, 0.03, -0.45), (2.9, 1.95, -0.042, -0.4),
    (5.2, 1.62, -0.042, -0.25), (6.6, 1.46, 0.0, 0.3), (7.4, 1.42, 0.1, 0.5),
    (8.4, 1.35, 0.45, 0.5),
)  # fmt: skip
DUMP = ((9.9, 1.6, 0.5, 0.5), (10.7, 1.7, 0.3, -0.8), (11.7, 2.15, 0.35, -0.45))
FIRST, SIDE, SECOND, PERIOD = -0.13, 1.1, 0.13, 12.2  # swing of cuts and dump; s from cut to cut


def path():
    """s [K] and, at these times, distance, height, lean, swing [K, 4]."""
    rows = []
    for start, cut, home in ((0.0, FIRST, SECOND), (PERIOD, SECOND, SECOND)):
        rows += [(start + t, *at, cut) for t, *at in CUT]
        rows += [(start + t, *at, SIDE if k < 2 else home) for k, (t, *at) in enumerate(DUMP)]
    return np.array(rows)[:, 0], np.array(rows)[:, 1:]


def joints(distance, height, lean, swing):
    """Angles [4] of the joints that bring the edge there."""
    # The pin of the bucket lies over its edge, behind it where it leans.
    x, z = distance + BUCKET * np.sin(lean), height + BUCKET * np.cos(lean) - PIVOT
    far = np.hypot(x, z)
    elbow = np.arccos((far**2 - BOOM**2 - STICK**2) / (2 * BOOM * STICK))
    boom = np.arctan2(z, x) + np.arctan2(STICK * np.sin(elbow), BOOM + STICK * np.cos(elbow))
    return np.array([swing, boom, -elbow, elbow - boom - lean])


def main(film=None, seconds: float = 2 * PERIOD - 0.4):
    """Digs; returns terrain, judgement, and rows of time, place of the edge, force on it, and
    whether the step was flagged."""
    ground = lts.Terrain.flat((2.6, 3.4), corner=(0.7, -1.7), height=0.0, floor=-0.6)
    spec = mujoco.MjSpec.from_file(str(FOLDER / 'excavator.xml'))
    add_height_field(spec, ground)
    m = spec.compile()
    d = mujoco.MjData(m)
    bucket = lts.Blade(width=0.4, radius=0.004, length=0.28, bucket=1, plates=1)
    live = lts.load('excavation/soil_field').stepper(ground, bucket)
    soil = MujocoSoil(m, d, {'edge': live})
    times, places = path()

    def target(t):
        k = min(np.searchsorted(times, t, side='right') - 1, len(times) - 2)
        share = np.clip((t - times[k]) / (times[k + 1] - times[k]), 0.0, 1.0)
        share = share * share * (3 - 2 * share)  # from rest to rest
        return joints(*places[k] + share * (places[k + 1] - places[k]))

    d.qpos[:] = target(0.0)
    soil.start()
    shots, rows, clock = Film(film, m, d, soil), [], time.process_time()
    for _ in range(round(seconds / m.opt.timestep)):
        d.ctrl[:] = target(d.time)
        frame = soil.step()['edge']
        rows.append([d.time, *frame.pose[:3], *frame.force, frame.now.status != 'ok'])
        shots.look()
    took = time.process_time() - clock
    rows = np.array(rows)
    print(f'{d.time:.1f} s in {took:.1f} s of one core')
    print(f'largest force {abs(rows[:, 4:7]).max():.0f} N')
    print(f'{100 * rows[:, -1].mean():.0f} % of steps flagged; first: {soil.judgement.reason}')
    print(f'trenches {-1e3 * ground.heights.min():.0f} mm deep')
    shots.write()
    return ground, soil.judgement, rows


if __name__ == '__main__':
    main(*sys.argv[1:2])
