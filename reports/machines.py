"""Machines in MuJoCo: recorded ones against the solver; where the coupling is stable; its speed.

machines: test runs whose tool was free (blades of kinds `free` and `actuated` of both datasets, one
wheel under its load of each kind), with the recorded mass, springs, dampers and loads, on three
grounds: the soil field; a spring and damper with friction; a classical formula (earthmoving, or
Bekker, Wong and Janosi with the damper). Errors are those against the recorded motion; work is that
of the soil's force on the tool. `coupling_mm`: how far the same field moves the tool otherwise in
`LoadedTool`, which solves the motion in another way: so much is of the coupling, the rest of the
field.
stability: a plate that falls by 1 mm and comes to rest, by time step and mass, with implicit and
explicit coupling.
examples: simulated seconds to seconds of one core at 1 kHz, MuJoCo included; what was flagged.

Examples:
    python -m reports machines --output_path=docs/machines
    python -m reports documents docs/mujoco.md     # the tables again, from the JSON
"""

import importlib
import sys
import time
from typing import Any

import numpy as np
from absl import flags

import learning_to_simulate as lts
from learning_to_simulate.baselines import earthmoving
from learning_to_simulate.baselines import wheel_terramechanics as terramechanics
from pca_tools import files
from reports import markdown, record

SUBSTEPS = 16  # of a recorded frame
# The spring ground: N/m, N s/m, friction.
STIFFNESS, DAMPING, FRICTION = 1e5, 2e3, 0.3
SMOOTH = 0.002  # m/s of a motion by which forces against it come in
END = 30  # frames at the end
STEPS, MASSES = (0.0005, 0.001, 0.002, 0.004, 0.008, 0.016), (5, 15, 50, 150, 500)
LINEAR = {'x': '1 0 0', 'z': '0 0 1', 'lean': '0 -1 0'}
GROUNDS = ('field', 'spring', 'formula')
MODELS = {'excavation': 'models/excavation/soil_field', 'wheel': 'models/wheel/soil_field'}
# Model -> the datasets whose test runs are repeated.
DATASETS = {'excavation': ('excavation', 'excavation_more'), 'wheel': ('wheel',)}
SETTLED = 0.001  # m about its last height


def machine_xml(run) -> str:
    """A tool with the mass of a run, and its free coordinates; the others are moved."""
    machine, pose = run.machine, run.pose[0]
    joints, actuators = '', ''
    inertia = max(machine.inertia, 1e-2)
    for (name, axis), free, k, c in zip(
        LINEAR.items(), machine.free, machine.stiffness, machine.damping, strict=True
    ):
        kind = 'hinge' if name == 'lean' else 'slide'
        heavy = '' if free else ' armature="1e9"'  # its motion is given
        joints += f'<joint name="{name}" type="{kind}" axis="{axis}"{heavy}/>'
        if free and (k or c):
            actuators += f'<position name="{name}" joint="{name}" kp="{k}" kv="{c}"/>'
    return f"""<mujoco><option timestep="{run.dt / SUBSTEPS}" integrator="implicitfast"
      gravity="0 0 -{run.soil.gravity}"/>
    <worldbody><body name="tool" pos="{pose[0]} {-pose[2]} {pose[1]}" gravcomp="1">{joints}
      <inertial pos="0 0 0" mass="{machine.mass}" diaginertia="{inertia} {inertia} {inertia}"/>
    </body></worldbody><actuator>{actuators}</actuator></mujoco>"""


def leans(poses) -> np.ndarray:
    """Angles (rad) about +z of poses [T, 7] that turn about z alone."""
    return np.unwrap(2.0 * np.arctan2(poses[:, 6], poses[:, 3]))


class Simple:
    """A ground without memory but for what was cut or pressed in: `spring` or `formula`."""

    def __init__(self, name, run, model, data):
        self._name, self._run, self._model, self._data = name, run, model, data
        self._level = float(np.median(run.before().heights))
        self._area = 0.0
        self._radius = run.tool.radius if run.tool.name == 'wheel' else 0.0
        self._start = run.pose[0, 0]
        if self._radius:
            way = self._start - run.pose[:, 0]
            wheel = terramechanics.Wheel(
                self._radius, run.tool.width, 0.0, run.soil.gravity, run.soil.friction,
                terramechanics.RIM_FRICTION,
            )  # fmt: skip
            # A wheel is moved along its path.
            soil = terramechanics.TerrainParameters()
            self._bed = terramechanics.Bed(wheel, soil, way.min(), way.max(), 80)
        self.force = np.zeros(2)

    def step(self):
        """One step of MuJoCo with the force of the step before."""
        import mujoco

        data, run = self._data, self._run
        x, z, lean = (data.joint(n).qvel[0] for n in LINEAR)
        depth = self._level - (data.body('tool').xpos[2] - run.tool.radius)
        if self._name == 'spring':
            up = max(STIFFNESS * depth - DAMPING * z, 0.0) if depth > 0 else 0.0
            slides = x + self._radius * lean
            force = np.array([-FRICTION * up * np.tanh(slides / SMOOTH), up])
        elif self._radius:
            turned = self._radius * data.joint('lean').qpos[0]
            travel = self._start - data.body('tool').xpos[0]
            self._bed.move(travel, turned)
            forward, up, _ = self._bed.forces(depth)
            self._bed.press(depth)
            damped = max(up - DAMPING * z, 0.0) if up > 0 else 0.0
            force = np.array([-forward, damped])
        else:
            self._area += max(depth, 0.0) * max(-x, 0.0) * self._model.opt.timestep
            force = self._cut(depth, x)
        data.qfrc_applied[:2] += force
        mujoco.mj_step(self._model, data)
        data.qfrc_applied[:2] -= force
        self.force = force

    def _cut(self, depth, speed):
        soil = earthmoving.BladeSoil.of(self._run.soil, self._run.tool)
        angle = self._data.joint('lean').qpos[0]
        parts = earthmoving.cutting_force(
            np.array([max(depth, 0.0)]), np.array([np.pi / 2 + angle]), np.array([self._area]), soil
        )
        # Of a tool that goes on; one that rests or goes back meets nothing.
        return parts[0].sum(axis=0) * np.tanh(max(-speed, 0.0) / SMOOTH)


def simulate(run, ground: str, field):
    """The machine of a run on a ground: x and height (m) and force [T, 4] of the frames, infinite
    of a machine that the field refuses, and the status of a field."""
    import mujoco

    from learning_to_simulate.mujoco_soil import MujocoSoil
    from learning_to_simulate.soil_field.stepper import SoilStepper

    model = mujoco.MjModel.from_xml_string(machine_xml(run))
    data = mujoco.MjData(model)
    target = np.column_stack([run.machine.target[:, :2], leans(run.machine.target)])
    first = np.array([*run.pose[0, :2], leans(run.pose[:1])[0]])
    zero = np.array([*first[:2], 0.0])  # of the joints: in the XML the tool stands upright
    data.qpos[:] = first - zero
    target[:, 2] += 2 * np.pi * np.round((first[2] - target[0, 2]) / (2 * np.pi))
    if ground == 'field':
        soil: Any = MujocoSoil(model, data, {'tool': SoilStepper(field, run.before(), run.tool)})
        soil.start()
    else:
        soil = Simple(ground, run, model, data)
        mujoco.mj_forward(model, data)
    rows = [[*first[:2], *(run.force[0, :2])]]
    h = model.opt.timestep
    for t in range(1, len(target)):
        rate = (target[t] - target[t - 1]) / run.dt
        load = run.machine.external[t, [0, 1, 5]]
        for k in range(SUBSTEPS):
            now = target[t - 1] + rate * h * (k + 1)
            for i, (name, free) in enumerate(zip(LINEAR, run.machine.free, strict=True)):
                joint = data.joint(name)
                if not free:
                    joint.qpos[0], joint.qvel[0] = now[i] - h * rate[i] - zero[i], rate[i]
                joint.qfrc_applied[0] = load[i] if free else 0.0
                if free and run.machine.stiffness[i]:
                    lead = run.machine.damping[i] / run.machine.stiffness[i] * rate[i]
                    data.actuator(name).ctrl[0] = now[i] + lead - zero[i]
            try:
                soil.step()
            except ValueError as error:  # it ran away
                return np.full((len(target), 4), np.inf), f'refused: {error}'
        force = soil.frames['tool'].force[:2] if ground == 'field' else soil.force
        rows.append([*(first[:2] + data.qpos[:2]), *force])
    status = str(soil.judgement.status) if ground == 'field' else None
    return np.array(rows), status


def figures(found, run) -> dict:
    """What is reported of a motion [T, 4] beside the recorded one; {} of a tool that was refused or
    that no ground bears, so that it ends a metre away."""
    true = np.column_stack([run.pose[:, :2], run.force[:, :2]])
    off = (found - true)[:, :2]
    if not np.abs(off).max() < 1.0:
        return {}
    ends = [np.linalg.norm(rows[-END:, 2:].mean(axis=0)) for rows in (found, true)]
    return {
        'rms_mm': rms_mm(off),
        'end_mm': float(1e3 * np.linalg.norm(off[-1])),
        'end_force_error': float(ends[0] / ends[1] - 1),
        'force_relative_l2': float(
            np.linalg.norm((found - true)[6:, 2:]) / np.linalg.norm(true[6:, 2:])
        ),
        'drift_mm_s': drift(found, run), 'true_drift_mm_s': drift(true, run),
        'ripple_mm': ripple(found), 'true_ripple_mm': ripple(true),
        'work_error': work(found) / work(true) - 1 if work(true) else None,
        'settling_s': settling(found, run), 'true_settling_s': settling(true, run),
    }  # fmt: skip


def rms_mm(off) -> float:
    """Root mean square, in mm, of the lengths of vectors [T, 2] in m."""
    return float(1e3 * np.sqrt(np.mean(np.sum(off**2, axis=1))))


def work(rows) -> float:
    """J of the soil's force on a tool along its motion [T, 4], by the trapezoid rule; the torque's
    is not in it."""
    means = (rows[1:, 2:] + rows[:-1, 2:]) / 2
    return float(np.sum(means * np.diff(rows[:, :2], axis=0)))


def settling(rows, run) -> float | None:
    """s from which on the height stays within `SETTLED` of its last one; None where the machine
    itself goes on."""
    if drift(rows, run) is None:
        return None
    off = np.abs(rows[:, 1] - rows[-1, 1]) > SETTLED
    return float(run.dt * (np.flatnonzero(off)[-1] + 1)) if off.any() else 0.0


def drift(rows, run) -> float | None:
    """mm/s over the last half second; None where the machine itself goes on."""
    target = np.column_stack([run.machine.target[-END:, :2], leans(run.machine.target[-END:])])
    if np.ptp(target, axis=0).max() > 1e-6:
        return None
    free = np.array(run.machine.free[:2])
    way = (rows[-1, :2] - rows[-END, :2])[free] / ((END - 1) * run.dt)
    return float(1e3 * np.linalg.norm(way))


def ripple(rows) -> float:
    """mm about a straight line over the last half second: a limit cycle."""
    t = np.arange(END) - (END - 1) / 2
    tail = rows[-END:, :2] - rows[-END:, :2].mean(axis=0)
    return rms_mm(tail - t[:, None] * (t @ tail) / (t @ t))


REST_S = 2.0  # of a plate on its weight


def rest(field, mass: float, dt: float, implicit: bool) -> dict:
    """A plate of 0.4 m on a vertical slide: largest share by which the force leaves the weight in
    the last half second, drift there (mm/s), sinkage (mm); or why it was refused."""
    import mujoco

    from learning_to_simulate.mujoco_soil import MujocoSoil
    from learning_to_simulate.soil_field.stepper import SoilStepper

    tool = lts.Blade(width=0.4)
    terrain = lts.Terrain.flat((2.0, 1.0), height=0.25)
    m = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{dt}"/><worldbody><body name="tool" pos="1 -.5 .265">'
        f'<joint type="slide" axis="0 0 1"/><inertial pos="0 0 .1" mass="{mass}" '
        'diaginertia="1 1 1"/></body></worldbody></mujoco>'
    )
    d = mujoco.MjData(m)
    soil = MujocoSoil(m, d, {'tool': SoilStepper(field, terrain, tool)}, implicit)
    rows, refused = [], ''
    try:
        soil.start()
        for _ in range(round(REST_S / dt)):
            force = soil.step()['tool'].force[1]
            rows.append([d.qpos[0], force / (mass * 9.81) - 1])
    except ValueError as error:
        refused = str(error)
    found = {'mass': mass, 'dt': dt, 'implicit': implicit, 'refused': refused}
    if not refused:
        tail = np.array(rows)[-round(0.5 / dt) :]
        found |= {
            'off_share': float(np.abs(tail[:, 1]).max()),
            'drift_mm_s': float(1e3 * (tail[-1, 0] - tail[0, 0]) / 0.5),
            'sinkage_mm': float(-1e3 * rows[-1][0]), 'status': str(soil.judgement.status),
        }  # fmt: skip
    return found


def whole(name: str) -> dict:
    """An example from its first to its last step, at 1 kHz, after a first second that compiles:
    simulated seconds to seconds of one core, and the share of steps that were flagged."""
    module = importlib.import_module(f'examples.{name}')
    module.main(seconds=1.0)
    clock = time.process_time()
    _, judgement, rows = module.main()
    ratio = float(rows[-1, 0] / (time.process_time() - clock))
    flagged = float(rows[:, -1].mean())
    return {'real_time_ratio': ratio, 'flagged_share': flagged, 'reason': judgement.reason}


def table(path: str) -> str:
    """Blades run by run, and the means of wheels, each on all grounds."""
    found = files.read_json(path)['machines']
    wheels = [row for row in found if row['tool'] == 'wheel']
    lines = [_line(row['case'], [row]) for row in found if row['tool'] != 'wheel']
    lines.append(_line(f'{len(wheels)} wheels, means', wheels))
    header = ('run', 'motion, rms mm', 'force at the end, %', 'work, %', 'settles after, s',
              'ripple, mm', 'drift, mm/s')  # fmt: skip
    return markdown.table(header, lines)


def _line(title, rows):
    def mean(ground, name, scale):
        known = [row[ground].get(name) for row in rows]
        values = [scale * abs(value) for value in known if value is not None]
        return f'{np.mean(values):.2g}' if values else '-'

    def all_of(name, scale=1.0):
        return ' / '.join(mean(ground, name, scale) for ground in GROUNDS)

    def beside(name):
        """Of the field and of the solver."""
        return f'{mean("field", name, 1.0)} / {mean("field", f"true_{name}", 1.0)}'

    drifts = [row['field']['drift_mm_s'] for row in rows if row['field']]
    at_rest = [drift for drift in drifts if drift is not None]
    drift = f'{max(at_rest):.1g}' if at_rest else 'goes on'
    return (title, all_of('rms_mm'), all_of('end_force_error', 100),
            mean('field', 'work_error', 100), beside('settling_s'), beside('ripple_mm'),
            drift)  # fmt: skip


def coupling_table(path: str) -> str:
    """How far coupling and `LoadedTool` move one field's tools apart, mm: largest by tool."""
    rows = files.read_json(path)['machines']
    tools = sorted({row['tool'] for row in rows})
    lines = [(t, max(r['coupling_mm'] or 0.0 for r in rows if r['tool'] == t)) for t in tools]
    return markdown.table(('tool', 'apart, rms mm'), lines)


def stability_table(path: str) -> str:
    """Largest share (%) by which the force leaves the weight, implicit / explicit."""
    cells = {(c['mass'], c['dt'], c['implicit']): c for c in files.read_json(path)['stability']}

    def share(c):
        if c['refused']:
            return 'refused'
        return '< 0.05' if c['off_share'] < 5e-4 else f'{100 * c["off_share"]:.2g}'

    def cell(mass, dt):
        return ' / '.join(share(cells[mass, dt, implicit]) for implicit in (True, False))

    lines = [(f'{m} kg', *(cell(m, dt) for dt in STEPS)) for m in MASSES]
    return markdown.table(('', *(f'{1e3 * dt:g} ms' for dt in STEPS)), lines)


def examples_table(path: str) -> str:
    """`whole` of each example."""
    lines = [
        (name, row['real_time_ratio'], f'{100 * row["flagged_share"]:.0f}', row['reason'])
        for name, row in files.read_json(path)['examples'].items()
    ]
    return markdown.table(('example', 'times real time', 'steps flagged, %', 'reason'), lines)


def apart(found, run, evaluator) -> float | None:
    """mm (root mean square) between a motion [T, 4] and that of `LoadedTool` on the same field;
    None where that one is refused."""
    other = np.asarray(evaluator.roll_out(run, under_load=True).pose)[:, :2]
    off = rms_mm(found[:, :2] - other)
    return off if np.isfinite(off) else None


def define_flags() -> None:
    flags.DEFINE_string('output_path', None, 'Path of the JSON file, without .json.', required=True)


def main(values) -> None:
    from learning_to_simulate.soil_field import evaluation, method, runs

    machines, fields = [], {name: method.load(path) for name, path in MODELS.items()}
    for name, field in fields.items():
        evaluator, kinds = evaluation.SoilEvaluator(field), set()
        for run in runs.read_all([f'datasets/{data}' for data in DATASETS[name]], 'test'):
            if run.machine is None or (run.tool.name == 'wheel' and run.kind in kinds):
                continue
            kinds.add(run.kind)
            row: dict = {'case': run.case, 'tool': run.tool.name, 'kind': run.kind}
            for ground in GROUNDS:
                found, status = simulate(run, ground, field)
                row[ground] = figures(found, run)
                if ground == 'field':
                    off = apart(found, run, evaluator) if row[ground] else None
                    row |= {'status': status, 'coupling_mm': off}
            machines.append(row)
            print(row['case'], [row[g].get('rms_mm') for g in GROUNDS], file=sys.stderr)
    path = f'{values.output_path}.json'
    files.write_json(path, {
        **record.provenance(1), 'machines': machines,
        'stability': [
            rest(fields['excavation'], mass, dt, implicit)
            for mass in MASSES for dt in STEPS for implicit in (True, False)
        ],
        'examples': {name: whole(name) for name in ('excavator', 'rover')},
    })  # fmt: skip
    for made in (table, coupling_table, stability_table, examples_table):
        print(made(path))
