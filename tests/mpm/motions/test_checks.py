"""What a motion must keep to, on both sides of each limit."""

import numpy as np
import pytest

from mpm import bodies, scenes
from mpm.motions import checks, grid
from mpm.motions.drive import Drive, Machine, under_load

BOX = scenes.EXCAVATION.bin
FLOOR = scenes.CORNER + BOX.dx
REAR = scenes.CORNER + BOX.size[0] - checks.WALL_GAP


def held(x=0.5, y=0.3, lean_deg=0.0, z=BOX.z_middle, body=None, machine=None):
    """A drive that stands still."""
    pose = np.array([x, y, -np.radians(lean_deg), z])
    return Drive(body or bodies.make_blade(), lambda t: np.tile(pose, (len(t), 1)), machine)


def along(x=0.6, y=0.3, turn=0.0, box=BOX, aside=0.0):
    """Poses over time from functions of it, or constants."""

    def pose(t):
        rows = [value(t) if callable(value) else value + 0 * t for value in (x, y, turn, aside)]
        return np.stack(rows, axis=1) + [0.0, 0.0, 0.0, box.z_middle]

    return pose


def refused(drive, words, frames=3, steps=54, box=BOX):
    with pytest.raises(ValueError, match=words):
        checks.check_drive(drive, box, frames, steps)


@pytest.mark.parametrize('scene', scenes.SCENES.values(), ids=lambda scene: scene.name)
def test_cases_of_the_grid_pass(scene):
    for case in range(1, scene.case_count + 1, 13):
        drive = grid.make_drive(scene, scene.parameters(case))
        checks.check_drive(drive, scene.bin, 320, 54)


def test_floor():
    checks.check_drive(held(y=FLOOR + 0.014 + 1e-6), BOX, 3, 54)
    refused(
        held(y=FLOOR + 0.014 - 1e-4),
        rf'at 0.000 s .* y = {FLOOR - 1e-4:.4f} m, the limit is {FLOOR:.4f} m.*floor',
    )
    deep = scenes.EXCAVATION.parameters(1) | {'depth_m': 0.16}
    refused(grid.make_drive(scenes.EXCAVATION, deep), r'at 6\.\d+ s the body reaches down', 400, 4)


def test_walls():
    checks.check_drive(held(x=REAR - 0.014 - 1e-6, y=0.2), BOX, 3, 54)
    refused(held(x=REAR - 0.014 + 1e-4, y=0.2), r'below the rim, the limit is 0\.8900 m.*behind')
    refused(held(x=scenes.CORNER + 0.02, y=0.2), r'x = 0\.1060 m.*wall in front')
    # A leaning top above the rim may stand over the wall; the same lean in the soil may not.
    checks.check_drive(held(x=0.82, y=0.27, lean_deg=45.0), BOX, 3, 54)
    refused(held(x=0.82, y=0.17, lean_deg=45.0), 'wall behind')


@pytest.mark.parametrize(('width', 'aside'), [(0.58, 0.0), (0.38, 0.1), (0.38, -0.1)])
def test_a_tool_wider_than_the_room_beside_it_is_refused(width, aside):
    drive = held(z=BOX.z_middle + aside, body=bodies.make_blade(width))
    checks.check_drive(drive, BOX, 3, 54)
    wider = held(z=BOX.z_middle + aside, body=bodies.make_blade(width + 0.002))
    refused(wider, f'{width + 0.002:.3f} m wide and stands {abs(aside):.4g} m beside.* 0.6 m of')


def test_speed_against_the_step_with_tip_and_rim():
    limit = 0.5 * BOX.dx * 60 * 8  # m/s, in steps of an eighth of a frame

    def sliding(axis, first, speed):
        return Drive(bodies.make_blade(), along(**{axis: lambda t: first - speed * t}))

    for axis, first, frames in (('x', 0.6, 6), ('aside', 0.05, 3)):
        checks.check_drive(sliding(axis, first, 0.99 * limit), BOX, frames, 8)
        words = rf'the body moves at .*\({limit:.4g} m/s\)'
        refused(sliding(axis, first, 1.01 * limit), words, frames, 8)
    wheel, box = bodies.make_wheel(0.15), scenes.WHEEL.bin

    def spinning(rim):
        return Drive(
            wheel, along(0.38, 0.0, lambda t: rim / wheel.reach * t, box), under_load(100.0)
        )

    limit = 0.5 * box.dx * 60 * 86
    checks.check_drive(spinning(0.99 * limit), box, 3, 86)
    refused(
        spinning(1.01 * limit), rf'at 0.0.. s the body moves at .*\({limit:.4g} m/s\)', 3, 86, box
    )


def test_lean_load_and_nan():
    refused(held(lean_deg=61.0), 'leans by 61 deg, at most 60')
    refused(held(x=np.nan), 'at 0.000 s the pose is')
    falling = under_load(lambda t: 100.0 - 3000.0 * t)
    wheel = held(x=0.38, z=scenes.WHEEL.bin.z_middle, body=bodies.make_wheel(0.15), machine=falling)
    words = r'at 0.03\d s the load is -?\d.* must be positive'
    refused(wheel, words, box=scenes.WHEEL.bin)


def test_a_target_in_the_soil_is_no_place_of_a_free_tool():
    """The actuator may pull deeper than the floor; the tool itself is looked at while it moves."""
    deep = held(y=scenes.CORNER)
    refused(deep, 'floor')
    machine = Machine((False, True, False), 20.0, lambda t: np.zeros((len(t), 3)))
    checks.check_drive(held(y=scenes.CORNER, machine=machine), BOX, 3, 54)


def test_what_never_fits_is_refused_after_some_tries():
    drawn = []

    def draw():
        drawn.append(held(y=0.1 if len(drawn) < 3 else 0.3))
        return drawn[-1], {'frames': 3, 'number': len(drawn)}

    drive, parameters = checks.first_that_fits(draw, BOX, 'a test')
    assert parameters['number'] == 4 and drive is drawn[3]
    with pytest.raises(ValueError, match='none of 200 motions of a test fits'):
        checks.first_that_fits(draw, BOX, 'a test', lambda drive, drawn: False)
