"""What a motion must keep to, on both sides of each limit."""

import numpy as np
import pytest

from mpm import bodies, scenes
from mpm.motions import checks, grid
from mpm.motions.drive import Drive

BOX = scenes.EXCAVATION.bin
FLOOR = scenes.CORNER + BOX.dx
REAR = scenes.CORNER + BOX.size[0] - checks.WALL_GAP


def held(x=0.5, y=0.3, lean_deg=0.0, body=None):
    """A drive that stands still."""
    pose = np.array([x, y, -np.radians(lean_deg)])
    return Drive(body or bodies.make_blade(BOX.z_middle), lambda t: np.tile(pose, (len(t), 1)))


def refused(drive, words, frames=3, steps=54, box=BOX):
    with pytest.raises(ValueError, match=words):
        checks.check_drive(drive, box, frames, steps)


@pytest.mark.parametrize('scene', scenes.SCENES.values(), ids=lambda scene: scene.name)
def test_every_case_of_the_grid_passes(scene):
    for case in range(1, scene.case_count + 1):
        drive = grid.make_drive(scene, scene.parameters(case))
        checks.check_drive(drive, scene.bin, 320, 54)


def test_floor():
    checks.check_drive(held(y=FLOOR + 0.014 + 1e-6), BOX, 3, 54)
    refused(
        held(y=FLOOR + 0.014 - 1e-4), r'at 0.000 s .* y = 0.1132 m, the limit is 0.1133 m.*floor'
    )
    deep = scenes.EXCAVATION.parameters(1) | {'depth_m': 0.15}
    refused(grid.make_drive(scenes.EXCAVATION, deep), r'at 5\.\d+ s the body reaches down', 400, 4)


def test_walls():
    upright = held(x=REAR - 0.014 - 1e-6, y=0.2)
    checks.check_drive(upright, BOX, 3, 54)
    refused(held(x=REAR - 0.014 + 1e-4, y=0.2), r'below the rim, the limit is 0\.8900 m.*behind')
    refused(held(x=scenes.CORNER + 0.02, y=0.2), r'x = 0\.1060 m.*wall in front')
    # A leaning top above the rim may stand over the wall; the same lean in the soil may not.
    checks.check_drive(held(x=0.82, y=0.27, lean_deg=45.0), BOX, 3, 54)
    refused(held(x=0.82, y=0.17, lean_deg=45.0), 'wall behind')
    refused(held(body=bodies.make_blade(BOX.z_middle, 0.59)), '0.59 m wide.*0.6 m of the bin')


def test_extent_below_against_a_cloud():
    """Never less than the extent of a cloud of points of the outline below the height."""
    blade = bodies.make_blade(BOX.z_middle)
    rng = np.random.default_rng(0)
    along = np.linspace(0, blade.length, 400)[:, None, None]
    turn = np.linspace(0, 2 * np.pi, 100)[None, :, None]
    axis = np.concatenate([np.zeros_like(along), along], axis=2)
    disc = np.concatenate([np.cos(turn), np.sin(turn)], axis=2) * blade.radius
    cloud = (axis + disc).reshape(-1, 2)
    for _ in range(50):
        x, y, theta = rng.uniform([0.3, 0.15, -1.0], [0.8, 0.35, 1.0])
        turned = cloud @ [[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]]
        turned += [x, y]
        low, high, lowest = (v[0] for v in checks.extent_below(blade, [[x, y, theta]], 0.26))
        assert lowest == pytest.approx(turned[:, 1].min(), abs=1e-4)
        below = turned[turned[:, 1] < 0.26, 0]
        if len(below):
            assert low <= below.min() + 1e-6 and high >= below.max() - 1e-6
            assert low > below.min() - 0.06 and high < below.max() + 0.06
        else:
            assert low == np.inf and high == -np.inf


def test_speed_against_the_step_with_tip_and_rim():
    limit = 0.5 * BOX.dx * 60 * 8  # m/s, in steps of an eighth of a frame

    def sliding(speed):
        blade = bodies.make_blade(BOX.z_middle)
        return Drive(blade, lambda t: np.stack([0.6 - speed * t, 0.3 + 0 * t, 0 * t], axis=1))

    checks.check_drive(sliding(0.99 * limit), BOX, 6, 8)
    refused(sliding(1.01 * limit), rf'the body moves at .*\({limit:.4g} m/s\)', 6, 8)
    wheel = bodies.make_wheel(0.15, scenes.WHEEL.bin.z_middle)

    def spinning(rim):
        turn = rim / wheel.radius
        return Drive(
            wheel,
            lambda t: np.stack([0.38 + 0 * t, 0 * t, turn * t], axis=1),
            lambda t: np.full(len(t), 100.0),
        )

    box = scenes.WHEEL.bin
    limit = 0.5 * box.dx * 60 * 86
    checks.check_drive(spinning(0.99 * limit), box, 3, 86)
    refused(
        spinning(1.01 * limit), rf'at 0.0.. s the body moves at .*\({limit:.4g} m/s\)', 3, 86, box
    )


def test_lean_load_and_nan():
    refused(held(lean_deg=61.0), 'leans by 61 deg, at most 60')
    refused(held(x=np.nan), 'at 0.000 s the pose is')
    wheel = bodies.make_wheel(0.15, scenes.WHEEL.bin.z_middle)
    still = held(x=0.38, body=wheel).pose
    refused(
        Drive(wheel, still, lambda t: 100.0 - 3000.0 * t),
        r'at 0.03\d s the load is -?\d.* must be positive',
        box=scenes.WHEEL.bin,
    )
