"""Soil under tools in MuJoCo: axes, wrenches, rest, turned scenes, what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import learning_to_simulate as lts

mujoco = pytest.importorskip('mujoco')
from learning_to_simulate.mujoco_soil import MujocoSoil, _ahead, add_height_field  # noqa: E402

# The edge 0.3 m under the centre of mass and 0.1 m ahead of it.
XML = """<mujoco><option timestep="{dt}"/><worldbody>
  <body name="carrier" pos="{at} {height}" euler="0 0 {heading}">{joints}
    <inertial pos="0.1 0 0.3" mass="{mass}" diaginertia="1 1 1"/>
    <site name="edge"/>
  </body></worldbody>{motors}</mujoco>"""
UP = '<joint type="slide" axis="0 0 1"/>'


@pytest.fixture(scope='module')
def blade():
    return lts.load('excavation/soil_field')


def scene(
    model, joints=UP, tool=None, implicit=True, height=0.27, mass=20.0, dt=0.004, heading=0.0,
    at='3 -2', motors='', **more,
):  # fmt: skip
    """A tool, by default a blade, on a square of soil whose surface is at 0.25 m."""
    stepper = model.stepper(flat(**more), tool or lts.Blade(width=0.4))
    text = XML.format(
        dt=dt, at=at, height=height, heading=heading, joints=joints, mass=mass, motors=motors
    )
    m = mujoco.MjModel.from_xml_string(text)
    d = mujoco.MjData(m)
    return m, d, MujocoSoil(m, d, {'edge': stepper}, implicit)


def flat(**more):
    return lts.Terrain.flat((6.0, 4.0), height=0.25, **more)


def test_pose_is_turned_into_axes_with_y_up(blade):
    m, d, soil = scene(blade, '<freejoint/>', at='1 -3')
    lean = Rotation.from_euler('Y', 25, degrees=True)  # about MuJoCo's Y: the top goes to +X
    d.qpos[3:] = np.roll(lean.as_quat(), 1)
    pose = soil.start()['edge'].pose
    np.testing.assert_allclose(pose[:3], [1.0, 0.27, 3.0], atol=1e-12)
    expected = Rotation.from_euler('z', -25, degrees=True)  # y up: about -z
    np.testing.assert_allclose(pose[3:], np.roll(expected.as_quat(), 1), atol=1e-12)


def test_wrench_is_about_the_centre_of_mass(blade):
    """The load of the frame before, of explicit coupling, by the rule of docs/axes.md."""
    m, d, soil = scene(blade, height=0.2, heading=30.0, implicit=False)
    frame = soil.start()['edge']
    for _ in range(20):
        last, place, centre = frame, d.site('edge').xpos.copy(), d.body('carrier').xipos.copy()
        frame = soil.step()['edge']
    force = np.array([last.force[0], -last.force[2], last.force[1]])
    own = np.array([last.torque[0], -last.torque[2], last.torque[1]])
    assert force[2] > 50.0 and abs(own).max() > 0.1
    lever = Rotation.from_euler('z', 30, degrees=True).apply([-0.1, 0.0, -0.3])
    np.testing.assert_allclose(place - centre, lever, atol=1e-12)
    expected = np.append(force, own + np.cross(lever, force))
    np.testing.assert_allclose(soil.wrenches[0], expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(d.xfrc_applied[1], expected, rtol=1e-9, atol=1e-9)


def test_no_load_before_it_touches_and_the_users_own_stays(blade):
    m, d, soil = scene(blade, height=0.4)
    d.xfrc_applied[1, 0] = 7.0
    frame = soil.start()['edge']
    for _ in range(10):
        soil.step()
    assert not frame.force.any() and not soil.wrenches.any()
    np.testing.assert_array_equal(d.xfrc_applied[1], [7.0, 0, 0, 0, 0, 0])
    fallen = 9.81 * m.opt.timestep**2 * 55
    assert d.qpos[0] == pytest.approx(-fallen, rel=1e-6)


@pytest.mark.parametrize(
    'dt, mass, implicit',
    [(0.001, 50.0, True), (0.004, 5.0, True), (0.016, 50.0, True), (0.001, 50.0, False),
     (0.008, 5.0, False)],
)  # fmt: skip
def test_a_tool_rests_on_its_weight_and_gains_no_energy(blade, dt, mass, implicit):
    m, d, soil = scene(blade, mass=mass, dt=dt, implicit=implicit)
    soil.start()
    for _ in range(round(2.0 / dt)):
        soil.step()
    at_rest, energies = d.qpos[0], []
    for _ in range(round(0.5 / dt)):
        force = soil.step()['edge'].force[1]
        energies.append(mass * (d.qvel[0] ** 2 / 2 + 9.81 * d.qpos[0]))
    assert force == pytest.approx(mass * 9.81, rel=0.005)
    assert abs(d.qpos[0] - at_rest) / 0.5 < 1e-4  # m/s
    assert max(energies) - energies[0] < 1e-5 * mass * 9.81
    assert soil.judgement.status == 'ok'


@pytest.mark.parametrize('kind, mass', [('blade', 90.0), ('wheel', 5.0)])
def test_it_comes_to_rest_where_a_loaded_tool_does(blade, kind, mass):
    """`LoadedTool` solves its motion in another way: a bracket for each coordinate."""
    model = blade if kind == 'blade' else lts.load('wheel/soil_field')
    tool, dt = lts.Blade(width=0.4) if kind == 'blade' else lts.Wheel(), 1 / 60
    pose = np.array([3.0, 0.251 + tool.radius, 2.0, 1.0, 0.0, 0.0, 0.0])
    stepper = model.stepper(flat(), tool)
    stepper.start(pose)
    body = lts.LoadedTool(stepper, mass)
    expected = [body.step(pose, dt=dt).pose[1] for _ in range(90)]
    m, d, soil = scene(model, tool=tool, height=pose[1], mass=mass, dt=dt)
    soil.start()
    heights = [soil.step()['edge'].pose[1] for _ in range(90)]
    # What holds it is what is reported.
    assert soil.frames['edge'].force[1] == pytest.approx(soil.wrenches[0, 2], rel=5e-3)
    assert pose[1] - expected[-1] > 0.002
    np.testing.assert_allclose(heights, expected, atol=1e-3)


@pytest.mark.parametrize('servo', ['position kp="2e4" kv="500"', 'velocity kv="5e3"', 'motor'])
def test_what_a_servo_holds_is_not_damped(blade, servo):
    """A machine of two joints, whose weight a user's force may hold as well."""
    joints = UP.replace('/>', ' name="z"/>')
    motors = f'<actuator><{servo} joint="z"/></actuator>'
    m, d, soil = scene(blade, joints, motors=motors)
    soil.start()
    # A motor bears the weight by itself.
    d.ctrl[0] = {'p': -0.03, 'v': -0.05, 'm': 150.0}[servo[0]]
    for _ in range(80):
        soil.step()
    assert d.qpos[0] < -0.006 and soil.frames['edge'].force[1] > 0
    assert soil._damping[0].coefficient == 0


def test_a_turned_scene_does_the_same(blade):
    """Forward at 45 degrees, where cells lie otherwise: flat soil does not know."""
    joints = '<joint type="slide" axis="1 0 0"/>' + UP
    ends = []
    for heading in (0.0, 90.0, 217.0):
        m, d, soil = scene(blade, joints, heading=heading, mass=40.0)
        turn = Rotation.from_euler('z', heading, degrees=True)
        soil.start()
        for _ in range(50):
            d.xfrc_applied[1, :3] = soil.wrenches[0, :3] + turn.apply([-60.0, 0.0, 0.0])
            soil.step()
        force = turn.inv().apply(soil.wrenches[0, :3])
        ends.append([*d.qpos, *d.qvel, *force / 100.0])
    assert ends[0][0] < -0.01 and ends[0][1] < -0.01
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-4)
    np.testing.assert_allclose(ends[2], ends[0], atol=1e-4)


def test_explicit_coupling_of_a_light_tool_rings_where_implicit_rests(blade):
    spans = []
    for implicit in (True, False):
        m, d, soil = scene(blade, mass=2.0, dt=0.016, implicit=implicit)
        soil.start()
        heights = [soil.step() and d.qpos[0] for _ in range(120)]
        spans.append(np.ptp(heights[-30:]))
    assert spans[0] < 1e-4 < spans[1]


def pair(blade, bodies, names):
    """Two tools on one terrain, for a second."""
    spec = mujoco.MjSpec.from_string(f'<mujoco><worldbody>{bodies}</worldbody></mujoco>')
    terrain = flat()
    add_height_field(spec, terrain)
    m = spec.compile()
    m.opt.timestep, d = 0.01, mujoco.MjData(m)
    tools = {name: blade.stepper(terrain, lts.Blade(width=0.4)) for name in names}
    soil = MujocoSoil(m, d, tools)
    soil.start()
    for _ in range(100):
        soil.step()
    return m, d, soil


def test_tools_share_a_terrain(blade):
    bodies = ''.join(
        f'<body name="b{i}" pos="3 {-1.3 - i} 0.27">{UP}'
        f'<inertial pos="0 0 0.1" mass="{10 + 40 * i}" diaginertia="1 1 1"/></body>'
        for i in (0, 1)
    )
    m, d, soil = pair(blade, bodies, ('b0', 'b1'))
    weights = [frame.force[1] / 9.81 for frame in soil.frames.values()]
    np.testing.assert_allclose(weights, [10.0, 50.0], rtol=0.005)
    soil.draw()
    # The height field shows the terrain: heights over each place, by MuJoCo's own ray.
    mujoco.mj_forward(m, d)
    down, hit = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)
    y = np.array([-1.3, -2.3, -3.5])
    far = [mujoco.mj_ray(m, d, np.array([3.13, at, 2.0]), down, None, 1, -1, hit) for at in y]
    known = soil.terrain.at(np.full(3, 3.13), -y)
    np.testing.assert_allclose(2.0 - np.array(far), known, atol=1e-3)
    assert soil.terrain.heights.min() < 0.249


def test_loads_of_tools_on_one_body_add_up(blade):
    sites = ''.join(f'<site name="s{i}" pos="0 {-i} 0"/>' for i in (0, 1))
    body = f'<body pos="3 -1.3 0.27">{UP}{sites}'
    body += '<inertial pos="0 -0.5 0.1" mass="60" diaginertia="1 1 1"/></body>'
    m, d, soil = pair(blade, body, ('s0', 's1'))
    np.testing.assert_allclose(d.xfrc_applied[1], soil.wrenches.sum(axis=0), atol=1e-9)
    assert d.xfrc_applied[1, 2] == pytest.approx(60 * 9.81, rel=0.005)
    assert (soil.wrenches[:, 2] > 200).all()


def test_a_drop_is_refused_and_nothing_is_lost(blade):
    m, d, soil = scene(blade, height=1.25, dt=0.002)
    soil.start()
    with pytest.raises(ValueError, match=r'edge: the pose jumps: 4\.\d+ m/s'):
        while True:
            state = d.qpos[0], d.qvel[0], d.time
            before = soil.terrain.heights.copy()
            soil.step()
    assert (d.qpos[0], d.qvel[0], d.time) == state and state[1] < -4.0
    np.testing.assert_array_equal(soil.terrain.heights, before)
    d.qvel[0] = -0.5  # caught: goes on
    assert soil.step()['edge'].force[1] >= 0.0


def test_coarse_soil_is_flagged_by_the_name_of_the_tool(blade):
    m, d, soil = scene(blade, height=0.25, cell=0.1)
    soil.start()
    soil.step()
    assert soil.judgement.status == 'extrapolating'
    assert soil.judgement.reason.startswith('edge: cell 0.1 is outside')
    d.qvel[0] = 2.5
    while d.qpos[0] < 0.3:
        soil.step()
    d.qvel[0] = 8.0  # so fast the stepper starts anew, in the air
    frame = soil.step()['edge']
    assert soil._steppers[0].frame.status == 'ok' and frame.status == 'extrapolating'
    assert soil.judgement.reason.startswith('edge: cell 0.1 is outside')
    assert soil.step()['edge'].status == 'extrapolating'
    assert soil.start()['edge'].status == 'ok' and soil.judgement.status == 'ok'


def test_bad_input_is_refused(blade):
    m, d, soil = scene(blade)
    stepper = soil._steppers[0]
    other = blade.stepper(lts.Terrain.flat((1.0, 1.0)))
    for tools, message in (
        ({'bucket': stepper}, r"no site or body 'bucket'; there are edge, world, carr"),
        ({'edge': {'vertices': []}}, 'edge: a stepper was expected, not a dict: .* no mesh'),
        ({}, 'tools is empty'),
        ({'edge': stepper, 'carrier': other}, 'several terrains'),
    ):
        with pytest.raises(ValueError, match=message):
            MujocoSoil(m, d, tools)
    for call, message in ((soil.step, 'call start'), (soil.draw, 'no height field')):
        with pytest.raises(ValueError, match=message):
            call()
    for step, gravity, message in (
        (0.02, -9.81, 'time step is 0.02 s'),
        (0.002, -1.62, r'lts.Soil\(gravity'),
    ):
        m.opt.timestep, m.opt.gravity[2] = step, gravity
        with pytest.raises(ValueError, match=message):
            MujocoSoil(m, d, {'edge': stepper})


def test_the_way_goes_on_and_the_turn_too():
    """Against scipy: four times a rotation vector."""
    first, vector = Rotation.random(random_state=1), np.array([0.01, -0.02, 0.015])
    poses = [np.roll((Rotation.from_rotvec(k * vector) * first).as_quat(), 1) for k in range(5)]
    first, second = (np.append([x, 0.0, 0.0], sign * pose) for x, sign, pose in
                     ((0.0, 1, poses[0]), (1.0, -1, poses[1])))  # fmt: skip
    for found in _ahead(np.array([first, first]), np.array([second, second]), 4.0):
        np.testing.assert_allclose(found[:3], [4.0, 0, 0])
        assert abs(found[3:] @ poses[4]) == pytest.approx(1.0, abs=1e-8)
