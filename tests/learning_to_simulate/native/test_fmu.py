"""The FMU by FMPy: valid, equal to the library, rolled back bit by bit, side by side."""

import itertools
import os
import subprocess
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

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


KINDS = {
    'blade': Blade(0.3, 0.02, 0.2, 1.0, floor_deg=9.0, floor_share=0.55),
    'wheel': Wheel(0.1, 0.08, 12, 0.008),
}
H = 1 / 64  # a sum of them is exact


# Kind of an FMU's tools -> index of each in the names of its variables.
INDICES = {'wheel': [''], 'blade': ['[1]', '[2]']}


@pytest.fixture(scope='module')
def soils(tmp_path_factory):
    """Kind of the tools -> path of an FMU and its field."""
    found, folder = {}, tmp_path_factory.mktemp('soils')
    for kind, indices in INDICES.items():
        field, path = worlds.soil_field(kind), str(folder / f'{kind}.fmu')
        fmu.write(path, f'lts_{kind}', soil_data.values(field), len(indices))
        found[kind] = path, field
    return found


def test_sources_alone_build_the_binary(soils, tmp_path):
    """As an importer on another machine does: one folder, no network, no flags."""
    with zipfile.ZipFile(soils['wheel'][0]) as archive:
        archive.extractall(tmp_path)
        names = archive.namelist()
    assert 'binaries/linux64/lts_wheel.so' in names or os.name != 'posix'
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


def _parameters(kind):
    """What makes the FMU's terrain and tools those of `_ground` and `KINDS`."""
    body, tool = 'tool' if kind == 'blade' else 'wheel', KINDS[kind]
    found = {
        'terrain.size.x': 3.0, 'terrain.size.z': 2.0, 'terrain.height': 0.1, 'terrain.depth': 0.6,
        'terrain.cell': 0.02, 'terrain.grid': 0.07, 'soil.friction_angle_deg': 33.0,
        'soil.density': 1600.0, 'soil.gravity': 3.7,
    }  # fmt: skip
    for index in INDICES[kind]:
        found |= {f'{body}{index}.{name}': getattr(tool, name) for name in vars(tool)}
    return found


def _ground():
    return Terrain.flat((3.0, 2.0), 0.1, 0.02, soil=Soil(33.0, 1600.0, 3.7), floor=-0.5)


# Down, then along and up, in N steps with a velocity and a turn about z.
WAYS = [(20, [-0.3, -0.15, 0.0], 0.6), (40, [-0.4, 0.0, 0.0], -0.25), (6, [-0.3, 0.05, 0.5], 0.0),
        (24, [-0.1, 0.6, 0.0], -2.0)]  # fmt: skip


def _go(start, radius=np.inf):
    """Inputs of `_Slave.set` along `WAYS`, each twist from its pose on; a wheel rolls as well."""
    place, angle = np.array(start, float), 0.0
    for count, velocity, turn in WAYS:
        turn -= velocity[0] / radius
        for _ in range(count):
            rot = [np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
            yield {'pos': place, 'rot': rot, 'lin_vel': velocity, 'ang_vel': [0, 0, turn]}
            place, angle = place + H * np.array(velocity), angle + H * turn


def _outputs(slave, index):
    ends = ('force', 'xyz'), ('moment', 'xyz')
    spreads = [(f'{part}_spread', ('along', 'up', 'across')) for part in ('force', 'moment')]
    names = [f'{slave.body}_load{index}.{n}.{end}' for n, some in (*ends, *spreads) for end in some]
    single = 'sinkage', 'drawbar_pull', 'force_bound', 'payload'
    return slave.reals(*names, *(f'{n}{index}' for n in single))


@pytest.mark.parametrize(
    'kind, flag, share, height',
    [('wheel', 'aside', 1e-9, 1e-12), ('blade', 'other_tool', 1e-6, 2e-6)],
)
def test_an_fmu_is_valid_and_equals_steppers(soils, kind, flag, share, height, tmp_path):
    """Two tools share float32 bins, whose round-off is that of `share` and `height`."""
    path, field = soils[kind]
    assert validation.validate_fmu(path) == []
    terrain, tool, indices = _ground(), KINDS[kind], INDICES[kind]
    starts = [[2.2, 0.12 + tool.radius, 1.0], [2.5, 0.12 + tool.radius, 1.15]][: len(indices)]
    lives = [SoilStepper(field, terrain, tool, engine='c') for _ in indices]
    body = 'tool' if kind == 'blade' else 'wheel'
    slave = _Slave(path, tmp_path, **_parameters(kind) | {
        f'{body}_state{i}.pos.{a}': v for i, s in zip(indices, starts) for a, v in zip('xyz', s)
    })  # fmt: skip
    for live, start in zip(lives, starts):
        live.start([*start, 1.0, 0, 0, 0])
    radius = tool.radius if kind == 'wheel' else np.inf
    found, expected = [], []
    for t, (now, coming) in enumerate(itertools.pairwise(zip(*(_go(s, radius) for s in starts)))):
        for index, inputs in zip(indices, now):
            slave.set(index, **inputs)
        if t == 30:  # what is refused of the last tool leaves the others where they were
            slave.set(indices[-1], pos=[9.0, 9.0, 9.0])
            with pytest.raises(FMICallException):
                slave.c.doStep(slave.time, H)
            category, text = slave.logged[-1]
            assert category == 'logStatusError' and text.startswith(f'tool {len(indices)}: ')
            slave.set(indices[-1], pos=now[-1]['pos'])
        slave.step(H)
        for index, live, inputs in zip(indices, lives, coming):
            frame = live.step(np.append(inputs['pos'], inputs['rot']), H)
            sunk = 0.1 - (frame.pose[1] - tool.radius)
            found.append(_outputs(slave, index))
            rest = [*frame.spread, sunk, -frame.force[0], -1.0, frame.payload]
            expected.append([*frame.force, *frame.torque, *rest])
            status = {n: slave.vr[f'status{index}.{n}'] for n in ('ok', 'ok_now', 'extrapolating')}
            said = slave.c.getString([slave.vr[f'status{index}.text']])[0].decode()
            ok = [not frame.reason, not frame.now.reason, bool(frame.reason)]
            assert said == frame.reason and slave.c.getBoolean(list(status.values())) == ok
    largest = np.abs(expected).max()
    assert np.abs(expected).max(axis=0)[[0, 1, 5, 6]].min() > 1e-3
    # A bucket takes up what it has cut, although it has left its plane in the soil.
    assert (max(frame[-1] for frame in expected) > 1e-4) == (kind == 'blade')
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=share * largest)
    # The number of the measure is that of its name.
    frame = lives[0].frame
    assert frame.reason.startswith(f'{flag} ')
    (number,) = slave.c.getInteger([slave.vr[f'status{indices[0]}.reason']])
    assert field.judged_names[number - 1] == flag
    assert [text for _, text in slave.logged if text.endswith(frame.reason.split()[-1])]
    axes = [terrain.cell[i] * (np.arange(terrain.shape[i]) + 0.5) for i in range(2)]
    between = RegularGridInterpolator(axes, terrain.heights)
    for index, live in zip(indices, lives):
        shown = [f'ground{index}.height[{i},{j}]' for i in range(1, 10) for j in (1, 3, 5)]
        places = np.array([(-0.07 * i, -0.07 * j) for i in range(-4, 5) for j in (-2, 0, 2)])
        wanted = between(live.frame.pose[[0, 2]] + places)
        np.testing.assert_allclose(slave.reals(*shown), wanted, atol=height)
        assert np.ptp(wanted) > 5e-4
    slave.free()


def test_directional_derivatives_are_differences_of_steps_and_leave_the_state(soils, tmp_path):
    path, _ = soils['wheel']
    description = fmpy.read_model_description(path)
    assert description.coSimulation.providesDirectionalDerivative
    start = [2.2, 0.2, 1.0]
    slave = _Slave(path, tmp_path, pos=start, **_parameters('wheel'))
    inputs = [n for n in slave.vr if n.startswith('wheel_state')]
    loads = [f'wheel_load.{part}.{a}' for part in ('force', 'moment') for a in 'xyz']
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
    path, _ = soils['wheel']
    start = [2.2, 0.2, 1.0]
    one = _Slave(path, tmp_path / 'a', pos=start, **_parameters('wheel'))
    other = _Slave(path, tmp_path / 'b', 'other', pos=[2.0, 0.3, 1.0])  # another terrain

    def go(slave, some):
        found = []
        for inputs in some:
            slave.set(**inputs)
            slave.step(H)
            found.append([*slave.get('force'), *slave.reals('ground.height[3,3]')])
        return found

    steps = list(_go(start))
    half = len(steps) // 2
    go(one, steps[:half])
    state, time = one.c.getFMUstate(), one.time
    saved = one.c.serializeFMUstate(state)
    first = go(one, steps[half:])
    go(other, [{'pos': [2.0, 0.3, 1.0], 'rot': [1, 0, 0, 0], 'lin_vel': [0, 0, 0]}])
    theirs = other.c.deSerializeFMUstate(saved)
    for slave, at in ((one, state), (other, theirs)):
        slave.c.setFMUstate(at)
        slave.time = time
        np.testing.assert_array_equal(go(slave, steps[half:]), first)
        slave.c.freeFMUstate(at)
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
    path, field = soils['wheel']
    for number, (name, value) in enumerate((
        ('terrain.cell', 0.0), ('terrain.cell', 1e-9), ('terrain.size.x', -1.0),
        ('pos', [2, -5, 1]), ('terrain.depth', -0.1), ('soil.friction_angle_deg', 90.0),
        ('wheel.width', 0.0), ('wheel.width', np.nan), ('wheel.lugs', -1.0),
        ('rot', [0, 0, 0, 0]), ('sinkage', 0.0),
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
