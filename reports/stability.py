"""Stability: what shipped models do on stiff and extreme cases.

No case has a truth beside it. A soil field goes through all of them, in C and in Python: what is
refused, what is flagged and by which number, what holds; whether all is finite; the largest force
over the weight of a block of soil as wide as the tool, as deep and long as its lowest point has
been (over its own weight, where a load moves it); soil that came or went, over what was cut. A tool
that falls must not gain energy. Networks in a subspace go through those cases that their inputs
can tell, along the path of a recorded run.

Examples:
    python -m reports stability --soil_field=models/excavation/soil_field \\
        --wheel=models/wheel/soil_field --data_path=datasets/excavation \\
        --model=pcg=models/excavation/pcg --model=mlp_driven=models/excavation/mlp_driven \\
        --output_path=docs/stability.json
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import tqdm
from absl import flags

import learning_to_simulate as lts
from learning_to_simulate.command import named_paths
from learning_to_simulate.live.poses import turned
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Soil
from pca_tools import files
from reports import markdown, record, times

GAIN, OFF = 0.01, 0.05  # energy over that of the fall, soil over the cut: more is wrong
AGREE = 1e-3  # of the force (root mean square), by which C and Python may differ
# Frames that are compared; under a load each frame is asked for twenty times.
MOST, MOST_LOADED = 100, 30


class Case(NamedTuple):
    """One case. Lengths are those of a tool of the usual size."""

    name: str  # for the table
    shape: str = 'plain'  # of the path, see `path_of`
    length: float = 0.4  # m in the soil
    dt: float = 1 / 60  # s of a frame
    scale: float = 1.0  # of tool, path and ground
    soil: dict = {}  # settings of `lts.Soil`
    load: float = 0.0  # where its weight moves the tool, over the usual one
    height: float = 0.0  # m from which it falls


CASES = (
    Case('a pass as in training'),
    Case('ten times as long', length=5.0),
    Case('two halts of 1 s', 'halts'),
    Case('turns in the air', 'air'),
    Case('into a wall', 'wall'),
    Case('off the map', 'edge'),
    Case('frames of 0.5 ms', length=0.1, dt=5e-4),
    Case('frames of 50 ms', dt=0.05),
    Case('friction angle 5 deg', soil={'friction_angle_deg': 5.0}),
    Case('friction angle 29 deg', soil={'friction_angle_deg': 29.0}),
    Case('friction angle 41 deg', soil={'friction_angle_deg': 41.0}),
    Case('friction angle 80 deg', soil={'friction_angle_deg': 80.0}),
    Case('gravity of the Moon', soil={'gravity': 1.62}),
    Case('ten g', soil={'gravity': 98.1}),
    Case('half the size', scale=0.5),
    Case('twice the size', scale=2.0),
    Case('sideways in the soil', 'aside'),
    Case('turns in the soil', 'turn'),
    Case('another tool 5 cm beside', 'two'),
    Case('a tenth of its weight', load=0.1),
    Case('under its weight', load=1.0),
    Case('ten times its weight', load=10.0),
    Case('falls 0.3 m', 'rest', load=1.0, height=0.3),
    Case('falls 1 m', 'rest', load=1.0, height=1.0),
)
# Usual tools: way a second, depth, lean or slip, kg.
USUAL = {
    'blade': {'speed': 0.2, 'depth': 0.03, 'lean': 0.2, 'mass': 20.0},
    'wheel': {'speed': 0.1, 'depth': 0.008, 'slip': 0.3, 'mass': 2.1},
}


def tool_of(kind, case: Case):
    """The usual tool in the size of a case."""
    sizes = {'width': kind().width, 'radius': kind().radius}
    if kind.name == 'blade':
        sizes['length'] = kind().length
    return kind(**{name: case.scale * size for name, size in sizes.items()})


def path_of(case: Case, tool) -> tuple[np.ndarray, float]:
    """Poses [T, 7] over ground at height 0, its corner at x = 0 and its middle at z = 0, and how
    far the ground runs along x, m.

    Down into the soil on 0.1 m, along, and up again. `halts` twice; `air` turns 0.4 m above;
    `wall` and `edge` go 0.1 m beyond the ground; `aside` and `turn` leave the plane of the passage
    in the second half, by 0.2 m or 45 degrees; `rest` stays where it is.
    """
    usual = USUAL[tool.name]
    s, way = case.scale, 0.2013 + case.length  # frames that no bin ends with
    count = int(np.ceil(way / usual['speed'] / case.dt)) + 1
    u = np.linspace(0, way, count)
    y = np.interp(u, [0, 0.1, way - 0.1, way], [0.01, -usual['depth'], -usual['depth'], 0.01])
    half = np.clip(2 * u / way - 1, 0, 1)
    if case.shape == 'halts':
        stay = np.ones(count, int)
        stay[[count // 3, 2 * count // 3]] = int(1 / case.dt)
        u, y, half = (np.repeat(x, stay) for x in (u, y, half))
    if case.shape == 'rest':
        u, y, half = np.zeros((3, int(1.5 / case.dt)))
    y = s * y + tool.radius + case.height + 0.4 * s * (case.shape == 'air')
    u = s * u
    lean = np.full(len(u), usual.get('lean', 0.0))
    if tool.name == 'wheel':
        lean = -u / tool.radius / (1 - usual['slip'])
    turn, aside = case.shape in ('air', 'turn'), case.shape == 'aside'
    ends = case.shape in ('wall', 'edge')
    begin = u[-1] - 0.1 * s if ends else u[-1] + s
    poses = np.zeros((len(u), 7))
    poses[:, 0], poses[:, 1], poses[:, 2] = begin - u, y, 0.2 * s * aside * half
    for pose, tilt, share in zip(poses, lean, half, strict=True):
        upright = turned((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -tilt))
        pose[3:] = turned(upright, (0.0, turn * share * np.pi / 4, 0.0))
    return poses, begin + s


def walked(case: Case, field, engine: str, most: int | None = None) -> dict:
    """What a soil field does in a case, in at most so many frames: poses and forces [T, ...] and
    reasons of frames, why it was refused, energy of the tool, soil that was cut and that came, m3.
    """
    from learning_to_simulate.soil_field.loaded import LoadedTool
    from learning_to_simulate.soil_field.stepper import SoilStepper

    tool = tool_of(type(field.networks.tool()), case)
    path, along = path_of(case, tool)
    soil, s = Soil(**case.soil), case.scale
    ground = Terrain.flat(
        (along, 2 * s), cell=0.02 * s, corner=(0.0, -s), soil=soil, walled=case.shape == 'wall'
    )
    before = ground.heights.copy()
    frames, refused, other, energy = [], '', None, []
    try:
        stepper = SoilStepper(field, ground, tool, engine=engine)
        frames.append(stepper.start(path[0]))
        step: Callable = stepper.step
        if case.shape == 'two':
            other = SoilStepper(field, ground, tool, engine=engine)
            shift = np.array([0, 0, tool.width + 0.05 * s, 0, 0, 0, 0])
            other.start(path[0] + shift)
        if case.load:
            mass = case.load * USUAL[tool.name]['mass'] * s**3
            loaded = LoadedTool(stepper, mass)

            def fall(pose, dt):
                frame = loaded.step(pose, dt=dt)
                kinetic = mass * loaded.velocity[1] ** 2 / 2
                energy.append(kinetic + mass * soil.gravity * frame.pose[1])
                return frame

            step = fall

        for pose in path[1:most]:
            frames.append(step(pose, case.dt))
            if other is not None:
                other.step(pose + shift, case.dt)
    except ValueError as error:
        refused = f'frame {len(frames)}: {error}'
    change = (ground.heights - before) * np.prod(ground.cell)
    return {
        'tool': tool, 'soil': soil, 'refused': refused,
        'pose': np.array([f.pose for f in frames]), 'force': np.array([f.force for f in frames]),
        'reasons': [f.now.reason for f in frames], 'energy': np.array(energy),
        'cut': float(-change[change < 0].sum()), 'came': float(change.sum()),
    }  # fmt: skip


def judged(case: Case, c: dict, python: dict) -> dict:
    """The row of a case, of what it is by C and in Python; `wrong` names what must not be."""
    tool, soil, force = c['tool'], c['soil'], c['force']
    size = np.linalg.norm(force, axis=1).max(initial=0.0)
    lowest = max(-(c['pose'][:, 1].min(initial=0.0) - tool.radius), 0.0) + tool.radius
    weight = soil.density * soil.gravity * tool.width * lowest**2
    row: dict = {'case': case.name, 'frames': len(force), 'largest_N': record.four(size)}
    if case.load:
        weight = case.load * USUAL[tool.name]['mass'] * case.scale**3 * soil.gravity
        if case.height:
            fall = weight * case.height
            start = weight * (c['pose'][0, 1])
            row['energy_gained'] = record.four(
                max((c['energy'].max(initial=start) - start) / fall, 0.0)
            )
    row['force_over_weight'] = record.four(size / weight)
    # Off the map soil goes, as it may.
    if c['cut'] > 1e-6 * case.scale**3 and case.shape != 'edge':
        row['soil_came'] = record.four(c['came'] / c['cut'])
    flagged = [reason for reason in c['reasons'] if reason]
    row['flagged'] = record.four(len(flagged) / max(len(force), 1))
    row['by'] = sorted({reason.split()[0] for reason in flagged})
    row['refused'] = c['refused']
    count = len(python['force'])
    alike = all(map(_says_the_same, c['reasons'][:count], python['reasons'])) and (
        c['refused'] == python['refused'] or count == compared(case) < len(force)
    )
    apart = _size(force[:count] - python['force']) if alike else np.inf
    row['python_differs'] = record.four(apart / max(_size(force[:count]), 1e-9))
    wrong = {
        'not finite': not np.isfinite(force).all(),
        'C is not Python': not apart <= AGREE * max(_size(force[:count]), 1e-9),
        'gains energy': row.get('energy_gained', 0.0) > GAIN,
        'loses soil': abs(row.get('soil_came', 0.0)) > OFF and not flagged,
    }  # fmt: skip
    return row | {'wrong': [name for name, is_so in wrong.items() if is_so]}


def _says_the_same(one, other):
    """Whether reasons have the same words, and numbers that differ by a last digit at most."""
    pairs = list(zip(one.split(), other.split(), strict=False))
    return len(one.split()) == len(other.split()) and all(
        a == b or (a[-1:].isdigit() and b[-1:].isdigit() and np.isclose(float(a), float(b), 2e-3))
        for a, b in pairs
    )


def compared(case: Case) -> int:
    """How many frames of a case Python goes through, too."""
    return MOST_LOADED if case.load else MOST


def _size(force):
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(force)))) if force.size else 0.0


def network(folder: str, data_path: str) -> list[dict]:
    """Rows of a method in a subspace, along the path of a recorded run: those cases that its
    inputs can tell."""
    model = lts.load(folder)
    run = lts.Dataset(data_path).test.records[times.driven(data_path)]
    path = np.asarray(run.rigid_pose, np.float64)
    late = np.clip(2 * np.arange(len(path)) / len(path) - 1, 0, 1)
    back = np.concatenate([path, path[::-1]])
    turn = path.copy()
    for pose, share in zip(turn, late, strict=True):
        pose[3:] = turned(pose[3:], (0.0, share * np.pi / 4, 0.0))
    up, aside = np.zeros((2, 7))
    up[1], aside[2] = 0.4, 0.2
    paths = {
        'a pass as in training': path,
        'ten times as long': np.tile(back, (5, 1)),
        'two halts of 1 s': np.repeat(path, 1 + 60 * np.isin(np.arange(len(path)), (50, 100)), 0),
        'turns in the air': turn + up,
        'sideways in the soil': path + late[:, None] * aside,
        'turns in the soil': turn,
    }
    recorded, rows = np.linalg.norm(run.force, axis=1).max(), []
    for name, poses in paths.items():
        found = model.rollout(poses)
        size = np.linalg.norm(found.force, axis=1).max()
        flagged = str(found.status) != 'ok'
        wrong = ['not finite'] * (not np.isfinite(found.force).all() and not flagged)
        rows.append({
            'case': name, 'status': str(found.status), 'reason': found.reason,
            'force_over_recorded': record.four(size / recorded), 'wrong': wrong,
        })  # fmt: skip
    for name, dt in (('frames of 0.5 ms', 5e-4), ('frames of 50 ms', 0.05)):
        live = model.stepper()
        live.start(path[0])
        try:
            status, why = str(live.step(path[1], dt=dt).status), ''
        except ValueError as error:
            status, why = 'refused', str(error)
        wrong = ['takes another time step'] * (status != 'refused')
        rows.append({'case': name, 'status': status, 'reason': why, 'wrong': wrong})
    return rows


def _outcome(row):
    """Of a soil field, for the table."""
    bad = f' **{", ".join(row["wrong"])}**' * bool(row['wrong'])
    if row['refused']:
        number, _, why = row['refused'].partition(': ')
        return f'refused ({number}: {" ".join(why.split()[:5])} ...){bad}'
    if row['by']:
        return f'flagged, {100 * row["flagged"]:.0f} % ({", ".join(row["by"])}){bad}'
    return f'holds{bad}'


def table(path: str) -> str:
    """Case by case, from the JSON."""
    found = files.read_json(path)
    fields = [{row['case']: row for row in found[tool]} for tool in ('blade', 'wheel')]
    nets = {name: {row['case']: row for row in rows} for name, rows in found['models'].items()}
    lines = []
    for name in fields[0]:
        line = [name]
        for rows in fields:
            row = rows[name]
            soil = row.get('soil_came')
            came = '' if soil is None else f'{100 * soil:.0f}'.replace('-0', '0')
            line += [_outcome(row), came]
        line += [rows[name]['status'] if name in rows else '' for rows in nets.values()]
        lines.append(line)
    twins = [max(row['python_differs'] or 0.0 for row in rows.values()) for rows in fields]
    lines.append(['*C against Python*', twins[0], '', twins[1], ''])
    header = ['case']
    for tool in ('blade', 'wheel'):
        header += [tool, 'soil that came, %']
    return markdown.table([*header, *nets], lines)


def define_flags() -> None:
    flags.DEFINE_string('soil_field', None, 'Folder of a soil field of a blade.', required=True)
    flags.DEFINE_string('wheel', None, 'Folder of one of a wheel.', required=True)
    flags.DEFINE_string('data_path', None, 'Dataset whose run networks follow.', required=True)
    flags.DEFINE_multi_string('model', [], 'NAME=FOLDER of networks in a subspace, of a blade.')
    flags.DEFINE_string('output_path', None, 'JSON file to write.', required=True)


def main(values) -> int:
    """Exit code 1 if something must not be as it is."""
    from learning_to_simulate.native.engines import TENSORFLOW, C
    from learning_to_simulate.soil_field import method

    found: dict = {'schema_version': 1, **record.provenance(1)}
    for tool, folder in (('blade', values.soil_field), ('wheel', values.wheel)):
        field = method.load(folder)
        found[tool] = [
            judged(case, walked(case, field, C), walked(case, field, TENSORFLOW, compared(case)))
            for case in tqdm.tqdm(CASES, unit='case', desc=tool, disable=None)
        ]
        files.write_json(values.output_path, found)
    models = named_paths('model', values.model, 'FOLDER')
    found['models'] = {name: network(path, values.data_path) for name, path in models.items()}
    files.write_json(values.output_path, found)
    print(table(values.output_path))
    rows = [*found['blade'], *found['wheel'], *(r for of in found['models'].values() for r in of)]
    return int(any(row['wrong'] for row in rows))
