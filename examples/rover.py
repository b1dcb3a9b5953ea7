"""A rover in MuJoCo drives over flat soil, under a growing pull, over its own rut and onto a heap;
slip and drawbar are plotted.

    python examples/rover.py drive.mp4 drive.png

Four driven wheels on a chassis that moves in a vertical plane: the wheel of a soil field knows no
forces across. The height of each wheel is that of the vehicle, and the soil answers with a force.
Wheels were taught ruts, but no heap as high as this one: there the status says so. Slip counts from
the rim; grousers reach farther, so that an unloaded wheel has a negative one.
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

RADIUS, WIDTH, RIM_SPEED = 0.06, 0.06, 0.08  # m, m, m/s
# m between axles and between wheels: no wheel has another one's ground in sight.
BASE, TRACK = 0.96, 0.94
NAMES = ('front_left', 'front_right', 'rear_left', 'rear_right')
# s from which on the rover drives (1) or stands (0), and the pull on it, N.
PLAN = ((0.0, 0, 0.0), (0.3, 1, 0.0), (4.0, 1, 14.0), (8.0, 1, 0.0), (20.0, 0, 0.0))


def drawn_plan(t):
    """Way and pull at a time: the pull grows from one line of the plan to the next."""
    k = np.searchsorted([line[0] for line in PLAN], t, side='right') - 1
    start, way, pull = PLAN[k]
    return way, pull * min((t - start) / 3.0, 1.0)


def machine(ground):
    """The model of MuJoCo: the chassis of rover.xml on four wheels."""
    spec = mujoco.MjSpec.from_file(str(FOLDER / 'rover.xml'))
    for i, name in enumerate(NAMES):
        place = [(i // 2 - 0.5) * BASE, (0.5 - i % 2) * TRACK, RADIUS - 0.14]
        wheel = spec.body('chassis').add_body(name=name, pos=place)
        wheel.add_joint(name=name, axis=[0, -1, 0], armature=1e-3)
        wheel.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[RADIUS, WIDTH / 2, 0], euler=[90, 0, 0],
            mass=0.4, rgba=[0.25, 0.25, 0.28, 1.0], contype=0, conaffinity=0,
        )  # fmt: skip
        for size in (
            (0.8 * RADIUS, WIDTH / 2 + 0.003, 0.008),
            (0.008, WIDTH / 2 + 0.003, 0.8 * RADIUS),
        ):
            wheel.add_geom(spec.find_default('spoke'), size=size)
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_velocity(kv=4.0)
    add_height_field(spec, ground)
    return spec.compile()


def main(film=None, picture=None, seconds: float = PLAN[-1][0], model='wheel/soil_field'):
    """Drives; returns terrain, judgement, rows of time, x, mean slip, drawbar, pull, sinkage, and
    whether the step was flagged."""
    heights = np.zeros((160, 80))  # 3.2 x 1.6 m
    x, _ = 0.01 + 0.02 * np.indices(heights.shape)
    heights += 0.03 * np.exp(-(((x - 0.7) / 0.15) ** 2))  # a heap across the way
    ground = lts.Terrain(heights, corner=(0.0, -0.8), floor=-0.5)
    m = machine(ground)
    d = mujoco.MjData(m)
    field, wheel = lts.load(model), lts.Wheel(WIDTH, RADIUS, lugs=12, lug_height=0.005)
    soil = MujocoSoil(m, d, {name: field.stepper(ground, wheel) for name in NAMES})
    soil.start()
    shots, rows, clock = Film(film, m, d, soil), [], time.process_time()
    for _ in range(round(seconds / m.opt.timestep)):
        way, pull = drawn_plan(d.time)
        d.ctrl[:] = way * RIM_SPEED / RADIUS
        d.qfrc_applied[0] = pull  # towards +X, against the way
        frames = soil.step()
        rim, speed = RADIUS * sum(d.qvel[3:].tolist()) / len(NAMES), -d.qvel[0]
        slip = 1 - speed / rim if rim > 0.02 else np.nan
        drawbar = -sum(frame.force[0] for frame in frames.values())
        sinkage = RADIUS - sum(frame.pose[1] for frame in frames.values()) / len(NAMES)
        flagged = any(frame.now.status != 'ok' for frame in frames.values())
        rows.append([d.time, d.qpos[0], slip, drawbar, pull, sinkage, flagged])
        shots.look()
    took, rows = time.process_time() - clock, np.array(rows)
    print(f'{d.time:.1f} s in {took:.1f} s of one core')
    print(f'{100 * rows[:, -1].mean():.0f} % of steps flagged; first: {soil.judgement.reason}')
    if picture:
        plot(rows, picture)
    shots.write()
    return ground, soil.judgement, rows


def plot(rows, picture):
    """Slip, drawbar and sinkage over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6), layout='constrained')
    panels = figure.subplots(3, 1, sharex=True)
    t = rows[:, 0]
    # Means over a frame of 1/15 s.
    smooth = [np.convolve(row, np.ones(67) / 67, 'same') for row in rows[:, 2:4].T]
    panels[0].plot(t, smooth[0])
    panels[0].set(ylabel='slip', ylim=(-0.3, 0.5))
    panels[1].plot(t, smooth[1], label='drawbar of the soil')
    panels[1].plot(t, rows[:, 4], label='pull on the chassis')
    panels[1].set(ylabel='N')
    panels[1].legend()
    panels[2].plot(t, 1e3 * rows[:, 5])
    panels[2].set(ylabel='sinkage below the\nflat soil, mm', xlabel='s')
    names = {0: 'stands', 1: 'drives'}
    for (start, way, pull), (end, *_) in zip(PLAN, PLAN[1:], strict=False):
        panels[0].axvline(start, color='0.8')
        what = names[way] + (', pulled' if pull else '')
        panels[0].text((start + end) / 2, 0.42, what if end - start > 1 else '', ha='center')
    figure.savefig(picture, dpi=110)


if __name__ == '__main__':
    main(*sys.argv[1:3])
