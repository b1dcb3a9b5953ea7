"""The FMU by FMPy: valid, equal to the library, rolled back bit by bit, side by side."""

import os
import subprocess
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest

import learning_to_simulate as lts
from learning_to_simulate.native import fmu, library, soil_data
from learning_to_simulate.soil_field.stepper import SoilStepper
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Blade, Soil, Wheel
from tests.learning_to_simulate.native import worlds

fmpy = pytest.importorskip('fmpy', reason='FMPy is not installed: pip install -e .[fmu]')
from fmpy import fmi2, validation  # noqa: E402
from fmpy.fmi1 import FMICallException  # noqa: E402

pytestmark = worlds.needs_c
PARTS = {'pos': 'xyz', 'rot': ('e0', 'e1', 'e2', 'e3'), 'lin_vel': 'xyz', 'ang_vel': 'xyz'}


class _Slave:
    """An instance of an FMU with its variables by name."""

    def __init__(self, path, folder, name='one', **inputs):
        description = fmpy.read_model_description(path)
        self.vr = {v.name: v.valueReference for v in description.modelVariables}
        is_tool = any(name.startswith('tool_state') for name in self.vr)
        self.body, self.logged = 'tool' if is_tool else 'wheel', []
        self.c = fmi2.FMU2Slave(
            guid=description.guid,
            unzipDirectory=fmpy.extract(path, unzipdir=str(folder)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(
            lambda env, name, status, category, message: self.logged.append(
                (category.decode(), message.decode())
            )
        )
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
        self.c.instantiate(callbacks=callbacks, loggingOn=True)
        self.c.setupExperiment(startTime=0.0)
        self.c.enterInitializationMode()
        self.set(**inputs)
        self.c.exitInitializationMode()
        self.time = 0.0

    def set(self, tool='', **parts):
        """Parts of the pose and twist of the body (`PARTS`), and other reals by name."""
        state = f'{self.body}_state{tool}'
        for part, values in parts.items():
            names = [f'{state}.{part}.{a}' for a in PARTS.get(part, ())] or [part]
            reference = [self.vr[n] for n in names]
            self.c.setReal(reference, [float(v) for v in np.atleast_1d(values)])

    def step(self, h):
        self.c.doStep(self.time, h)
        self.time += h

    def get(self, part, tool=''):
        return self.reals(*(f'{self.body}_load{tool}.{part}.{a}' for a in 'xyz'))

    def reals(self, *names):
        return np.array(self.c.getReal([self.vr[name] for name in names]))

    def free(self):
        self.c.terminate()
        self.c.freeInstance()


def assert_states_go_on(one, other, steps, elsewhere, h, further=()):
    """After half of the steps (inputs of `_Slave.set`) of the one, the others give the same bits:
    again, and from the bytes of the state in another instance that was elsewhere. Returns the
    bytes."""

    def go(slave, some):
        found = []
        for inputs in some:
            slave.set(**inputs)
            slave.step(h)
            found.append([*slave.get('force'), *slave.reals(*further)])
        return found

    half = len(steps) // 2
    go(one, steps[:half])
    state, time = one.c.getFMUstate(), one.time
    saved = one.c.serializeFMUstate(state)
    first = go(one, steps[half:])
    go(other, elsewhere)
    theirs = other.c.deSerializeFMUstate(saved)
    for slave, at in ((one, state), (other, theirs)):
        slave.c.setFMUstate(at)
        slave.time = time
        np.testing.assert_array_equal(go(slave, steps[half:]), first)
        slave.c.freeFMUstate(at)
    return saved


KINDS = {'blade': Blade(0.3, 0.02, 0.2, 1.0), 'wheel': Wheel(0.1, 0.08, 12, 0.008)}
SOIL = Soil(33.0, 1600.0, 3.7)
H = 1 / 64  # a sum of them is exact


@pytest.fixture(scope='module')
def soils(tmp_path_factory):
    """Kind of a tool, and number of them -> path of an FMU and its field."""
    found, folder = {}, tmp_path_factory.mktemp('soils')
    for kind, tools in (('blade', 1), ('wheel', 1), ('blade', 2)):
        field, path = worlds.soil_field(kind), str(folder / f'{kind}_{tools}.fmu')
        fmu.write(path, f'lts_{kind}', soil_data.values(field), tools)
        found[kind, tools] = path, field
    return found


def test_sources_alone_build_the_binary(soils, tmp_path):
    """As an importer on another machine does: one folder, no network, no flags."""
    with zipfile.ZipFile(soils['blade', 1][0]) as archive:
        archive.extractall(tmp_path)
        names = archive.namelist()
    assert 'binaries/linux64/lts_blade.so' in names or os.name != 'posix'
    root = ElementTree.parse(tmp_path / 'modelDescription.xml')
    listed = [file.get('name') for file in root.iter('File')]
    sources = [str(tmp_path / 'sources' / name) for name in listed]
    built = str(tmp_path / 'again.so')
    subprocess.run(
        [*library.compiler(), '-O0', '-fPIC', '-shared', f'-I{tmp_path}/sources', *sources,
         '-o', built, '-lm'], check=True,
    )  # fmt: skip
    symbols = subprocess.run(['nm', '-D', built], capture_output=True, text=True).stdout
    assert sum(' T fmi2' in line for line in symbols.splitlines()) == 34


def _parameters(kind, tools=1, cell=0.02):
    """What makes the FMU's terrain and tools those of `_ground` and `KINDS`."""
    body, tool = 'tool' if kind == 'blade' else 'wheel', KINDS[kind]
    of_soil = {'friction_angle_deg': 33.0, 'density': 1600.0, 'gravity': 3.7}
    found = {
        'terrain.size.x': 3.0, 'terrain.size.z': 2.0, 'terrain.height': 0.1, 'terrain.depth': 0.6,
        'terrain.cell': cell, 'terrain.grid': 0.07,
    } | {f'soil.{name}': value for name, value in of_soil.items()}  # fmt: skip
    for index in [''] if tools == 1 else [f'[{k + 1}]' for k in range(tools)]:
        found |= {f'{body}{index}.{name}': getattr(tool, name) for name in vars(tool)}
    return found


def _ground(cell=0.02):
    return Terrain.flat((3.0, 2.0), 0.1, cell, soil=SOIL, floor=-0.5)


# Down, then along and up, in N steps with a velocity and a turn about z.
WAYS = [(20, [-0.3, -0.15, 0.0], 0.6), (40, [-0.4, 0.0, 0.0], -0.25), (6, [-0.3, 0.05, 0.5], 0.0)]


def _go(start, radius=np.inf):
    """Inputs of `_Slave.set` along `WAYS`, each twist from its pose on; a wheel rolls as well."""
    place, angle = np.array(start, float), 0.0
    for count, velocity, turn in WAYS:
        turn -= velocity[0] / radius
        for _ in range(count):
            rot = [np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
            yield {'pos': place, 'rot': rot, 'lin_vel': velocity, 'ang_vel': [0, 0, turn]}
            place, angle = place + H * np.array(velocity), angle + H * turn


def _pose_of(inputs):
    return np.append(inputs['pos'], inputs['rot'])


@pytest.mark.parametrize('kind', KINDS)
def test_a_soil_field_is_valid_and_equals_the_stepper(soils, kind, tmp_path):
    path, field = soils[kind, 1]
    assert validation.validate_fmu(path) == []
    terrain, tool, scale = _ground(), KINDS[kind], KINDS[kind].radius
    live = SoilStepper(field, terrain, tool, engine='c')
    start = [2.2, 0.12 + scale, 1.0]
    slave = _Slave(path, tmp_path, pos=start, **_parameters(kind))
    live.start([*start, 1.0, 0, 0, 0])
    rim = scale if kind == 'wheel' else np.inf
    steps, found, expected = list(_go(start, rim)), [], []
    load = f'{slave.body}_load'
    spreads = [f'{load}.{part}_spread.{way}' for part in ('force', 'moment')
               for way in ('along', 'up', 'across')]  # fmt: skip
    for inputs, coming in zip(steps, steps[1:]):
        slave.set(**inputs)
        slave.step(H)
        frame = live.step(_pose_of(coming), H)
        sunk = 0.1 - (frame.pose[1] - scale)
        rest = slave.reals(*spreads, 'sinkage', 'drawbar_pull', 'force_bound')
        found.append([*slave.get('force'), *slave.get('moment'), *rest])
        expected.append([*frame.force, *frame.torque, *frame.spread, sunk, -frame.force[0], -1.0])
        assert slave.c.getString([slave.vr['status.text']])[0].decode() == frame.reason
        ok = slave.c.getBoolean(
            [slave.vr[f'status.{n}'] for n in ('ok', 'ok_now', 'extrapolating')]
        )
        assert ok == [not frame.reason, not frame.now.reason, bool(frame.reason)]
    assert np.abs(expected).max(axis=0)[[0, 1, 5, 6]].min() > 1e-3
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    # A drive aside is flagged, and the number of the measure is that of its name.
    assert frame.reason.startswith('aside ')
    (number,) = slave.c.getInteger([slave.vr['status.reason']])
    assert live.field.judged_names[number - 1] == 'aside'
    assert [text for _, text in slave.logged if text.endswith(frame.now.reason.split()[-1])]
    shown = [f'ground.height[{i},{j}]' for i in range(1, 10) for j in (1, 3, 5)]
    x, _, z = frame.pose[:3]
    wanted = [
        _height(terrain, x - 0.07 * i, z - 0.07 * j) for i in range(-4, 5) for j in (-2, 0, 2)
    ]
    np.testing.assert_allclose(slave.reals(*shown), wanted, atol=1e-12)
    assert np.ptp(wanted) > 5e-4
    slave.free()


def _height(terrain, x, z):
    """Between the middles of cells, by SciPy."""
    from scipy.interpolate import RegularGridInterpolator

    axes = [terrain.cell[i] * (np.arange(terrain.shape[i]) + 0.5) for i in range(2)]
    return RegularGridInterpolator(axes, terrain.heights)([[x, z]])[0]


def test_two_tools_on_one_terrain_equal_two_steppers(soils, tmp_path):
    path, field = soils['blade', 2]
    assert validation.validate_fmu(path) == []
    terrain = _ground()
    lives = [SoilStepper(field, terrain, KINDS['blade'], engine='c') for _ in range(2)]
    starts, names = [[2.2, 0.15, 1.0], [2.5, 0.14, 1.15]], ('[1]', '[2]')
    slave = _Slave(path, tmp_path, **_parameters('blade', 2) | {
        f'tool_state{n}.pos.{a}': v for n, s in zip(names, starts) for a, v in zip('xyz', s)
    })  # fmt: skip
    for live, start in zip(lives, starts):
        live.start([*start, 1.0, 0, 0, 0])
    ways = [list(_go(start)) for start in starts]
    found, expected = [], []
    for t in range(len(ways[0]) - 1):
        for name, way in zip(names, ways):
            slave.set(name, **way[t])
        if t == 30:  # what is refused of the second tool leaves the first where it was
            slave.set('[2]', pos=[9.0, 9.0, 9.0])
            with pytest.raises(FMICallException):
                slave.c.doStep(slave.time, H)
            assert slave.logged[-1] == ('logStatusError', slave.logged[-1][1])
            assert slave.logged[-1][1].startswith('tool 2: ')
            slave.set('[2]', pos=ways[1][t]['pos'])
        slave.step(H)
        frames = [live.step(_pose_of(way[t + 1]), H) for live, way in zip(lives, ways)]
        found.append(np.concatenate([slave.get('force', name) for name in names]))
        expected.append(np.concatenate([frame.force for frame in frames]))
    assert (np.abs(expected).max(axis=0)[[0, 1, 3, 4]] > 0.1).all()
    assert frames[0].reason.startswith('other_tool')
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())  # float32
    for live, name in zip(lives, names):
        x, z = live.frame.pose[[0, 2]]
        np.testing.assert_allclose(
            slave.reals(f'ground{name}.height[5,3]'), _height(terrain, x, z), atol=2e-6
        )
    slave.free()


def test_directional_derivatives_are_differences_of_steps_and_leave_the_state(soils, tmp_path):
    path, _ = soils['blade', 1]
    description = fmpy.read_model_description(path)
    assert description.coSimulation.providesDirectionalDerivative
    start = [2.2, 0.14, 1.0]
    slave = _Slave(path, tmp_path, pos=start, **_parameters('blade'))
    inputs = [n for n in slave.vr if n.startswith('tool_state')]
    loads = [f'tool_load.{part}.{a}' for part in ('force', 'moment') for a in 'xyz']
    known, unknown = ([slave.vr[n] for n in names] for names in (inputs, loads))
    *steps, last = list(_go(start))[:46]
    for given in steps:
        slave.set(**given)
        slave.step(H)
    at = np.concatenate(list(last.values()))
    state = slave.c.getFMUstate()

    def after(values):
        slave.c.setFMUstate(state)
        slave.c.setReal(known, list(values))
        slave.c.doStep(slave.time, H)
        return np.array(slave.c.getReal(unknown))

    held = after(at)
    slave.c.setFMUstate(state)
    slave.c.setReal(known, list(at))
    rng = np.random.default_rng(2)
    seeds = np.vstack([np.eye(13)[[0, 1, 6, 7, 8, 12]], rng.normal(size=(3, 13))])
    for seed in seeds:
        found = slave.c.getDirectionalDerivative(unknown, known, list(seed))
        way = np.linalg.norm(seed[:3]) + H * np.linalg.norm(seed[7:10]) + 0.1 * (
            2 * np.linalg.norm(seed[3:7]) + H * np.linalg.norm(seed[10:]))  # fmt: skip
        step = 1e-4 / way
        wanted = (after(at + step * seed) - after(at - step * seed)) / (2 * step)
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-6 * np.abs(wanted).max())
        assert np.abs(wanted).max() > 1e-3
        slave.c.setFMUstate(state)
        slave.c.setReal(known, list(at))
    slave.c.getDirectionalDerivative(unknown, known, [0.0] * 13)
    slave.c.doStep(slave.time, H)
    np.testing.assert_array_equal(slave.c.getReal(unknown), held)
    for wrong in (([slave.vr['sinkage']], known[:1]), (unknown[:1], [slave.vr['terrain.cell']])):
        with pytest.raises(FMICallException):
            slave.c.getDirectionalDerivative(*wrong, [1.0])
    slave.c.freeFMUstate(state)
    slave.free()


def test_states_of_a_soil_field_go_to_other_instances_and_on_to_the_same_bits(soils, tmp_path):
    path, _ = soils['blade', 1]
    start = [2.2, 0.14, 1.0]
    one = _Slave(path, tmp_path / 'a', pos=start, **_parameters('blade'))
    other = _Slave(path, tmp_path / 'b', 'other', pos=[2.0, 0.3, 1.0])  # another terrain
    resting = {'pos': [2.0, 0.3, 1.0], 'rot': [1, 0, 0, 0], 'lin_vel': [0, 0, 0]}
    saved = assert_states_go_on(one, other, list(_go(start)), [resting], H, ['ground.height[3,3]'])
    half = other.c.deSerializeFMUstate(saved[: len(saved) // 2])
    with pytest.raises(FMICallException):
        other.c.setFMUstate(half)
    with pytest.raises(FMICallException):
        other.step(H)
    other.c.freeFMUstate(half)
    other.c.reset()
    for slave in (one, other):
        slave.free()


def test_what_no_soil_field_can_be_is_refused(soils, tmp_path):
    path, field = soils['blade', 1]
    for number, (name, value) in enumerate((
        ('terrain.cell', 0.0), ('terrain.cell', 1e-9), ('terrain.size.x', -1.0), 
        ('pos', [2, -5, 1]),
        ('terrain.depth', -0.1), ('soil.friction_angle_deg', 90.0), ('tool.width', 0.0),
        ('tool.bucket', 0.5), ('rot', [0, 0, 0, 0]), ('tool.width', np.nan), 
        ('sinkage', 0.0),
    )):  # fmt: skip
        with pytest.raises(FMICallException):
            _Slave(path, tmp_path / str(number), **{name: value})
    slave = _Slave(path, tmp_path / 'x')
    for act in (
        lambda: slave.set(**{'terrain.cell': 0.01}),
        lambda: slave.set(lin_vel=[np.inf, 0, 0]),
        lambda: (slave.set(pos=[1.0, 0.2, 1.0]), slave.step(H)),
        lambda: slave.c.setInteger([slave.vr['status.reason']], [1]),
        lambda: slave.c.getString([7]),
        lambda: slave.c.doStep(0.0, 0.0),
    ):
        with pytest.raises(FMICallException):
            act()
    slave.free()
    values = soil_data.values(field)
    for tools in (0, 17):
        with pytest.raises(ValueError, match=f'tools is {tools}'):
            fmu.layout_of(values, tools)


def test_a_blade_of_20_kg_comes_to_rest_under_its_weight_by_an_implicit_master(tmp_path):
    """Backward Euler of its height, by Newton with the FMU's derivative, between bounds."""
    model, path = lts.load('excavation'), str(tmp_path / 'soil.fmu')
    fmu.write(path, 'lts_excavation', soil_data.values(model.model))
    mass, gravity, h, y, speed = 20.0, 9.81, 0.004, 0.02, 0.0
    slave = _Slave(path, tmp_path / 'x', pos=[2.0, y, 1.0])
    force, height, rate = (
        [slave.vr[f'tool_{n}.y']] for n in ('load.force', 'state.pos', 'state.lin_vel')
    )
    slopes, ends = [], []
    for _ in range(150):
        state = slave.c.getFMUstate()
        low, high, trial = -2.0, 1.0, speed
        for _ in range(60):
            slave.c.setReal(height + rate, [y, trial])
            (slope,) = slave.c.getDirectionalDerivative(force, rate, [1.0])
            slave.c.doStep(slave.time, h)
            (up,) = slave.c.getReal(force)
            wrong = mass * (trial - speed) / h - up + mass * gravity
            if abs(wrong) < 0.01 or high - low < 1e-9:
                break
            low, high = (trial, high) if wrong < 0 else (low, trial)
            trial -= wrong / (mass / h - slope)
            trial = trial if low < trial < high else (low + high) / 2
            slave.c.setFMUstate(state)
        slave.c.freeFMUstate(state)
        slave.time, y, speed = slave.time + h, y + h * trial, trial
        slopes.append(slope)
        ends.append([y, speed, up])
    ends = np.array(ends)
    np.testing.assert_allclose(ends[-20:, 2], mass * gravity, rtol=0.005)
    assert np.ptp(ends[-20:, 0]) < 1e-5 and np.abs(ends[-20:, 1]).max() < 1e-3
    assert min(slopes) < -1.0 and ends[-1, 0] < 0.014  # it stands in the soil
    slave.free()
