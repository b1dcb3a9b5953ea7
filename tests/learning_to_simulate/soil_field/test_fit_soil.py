"""A soil from recorded digs: what a model made itself is found again, and what tells nothing says
so."""

import copy
import dataclasses
import json
import re

import numpy as np
import pytest

from learning_to_simulate import shipped
from learning_to_simulate.soil_field import fit_soil, method
from learning_to_simulate.soil_field.digs import Dig
from learning_to_simulate.soil_field.fit_soil import Rolled
from learning_to_simulate.soil_field.stepper import SoilStepper
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Blade, Soil
from tests.pca_tools.commands import call_command

# In a much lighter soil grains would be stiffer against their weight than a fit takes them for.
ANGLE, DENSITY = 34.3, 1600.0
FRAMES, DT = 180, 1 / 60


@pytest.fixture(scope='module')
def field():
    return method.load(shipped.find('excavation', 'models'))


def path(depth, speed):
    """[T, 7] of a blade that goes down and then along -x."""
    times = DT * np.arange(FRAMES)
    pose = np.zeros((FRAMES, 7))
    pose[:, 0] = -speed * np.maximum(times - 0.3, 0.0)
    pose[:, 1] = 0.02 - (0.006 + depth) * np.clip(times / 0.5, 0.0, 1.0)
    pose[:, 3] = 1.0
    return pose


def dig(field, depth=0.05, speed=0.1, angle=ANGLE, density=DENSITY, gravity=9.81):
    """A dig with the force of the model itself."""
    soil = Soil(angle, density, gravity)
    ground = Terrain.flat((2.4, 1.6), corner=(-1.6, -0.8), soil=soil)
    way, blade = path(depth, speed), Blade(width=0.4)
    stepper = SoilStepper(field, ground.clone(), blade)
    frames = [stepper.start(way[0]), *(stepper.step(pose, DT) for pose in way[1:])]
    force = np.array([frame.force for frame in frames])
    # Of the soil that it starts from only gravity may count.
    ground = ground.clone(Soil(gravity=gravity))
    return Dig(f'{depth} {speed}', blade, ground, DT * np.arange(FRAMES), way, force)


@pytest.fixture(scope='module')
def digs(field):
    return [dig(field, *way) for way in ((0.05, 0.1), (0.03, 0.06), (0.08, 0.05))]


@pytest.fixture(scope='module')
def rolled(field, digs):
    return [Rolled(field, one) for one in digs]


def again(rolled, force):
    """The same rollouts beside another measured force, without new ones."""
    made = copy.copy(rolled)
    made.meet(dataclasses.replace(rolled.dig, force=force))
    return made


def test_the_soil_that_a_model_made_is_found(rolled):
    found = fit_soil.fit(rolled)
    assert not found.reasons
    # Forces between whole degrees are interpolated.
    assert found.angle_deg == pytest.approx(ANGLE, abs=0.15)
    assert found.density == pytest.approx(DENSITY, rel=0.02)
    assert found.misfit < 0.01
    assert [run['flagged'] for run in found.runs] == [0.0] * 3
    assert set(found.left_out) == {one.dig.name for one in rolled}


def test_angle_and_density_stand_in_for_each_other_by_as_much_as_is_said(rolled):
    """And a heavier soil is the same at more force."""
    free, more = fit_soil.fit(rolled), fit_soil.fit(rolled, 0.95 * DENSITY)
    heavy = fit_soil.fit([again(r, 1.2 * r.dig.force) for r in rolled])
    assert heavy.angle_deg == free.angle_deg
    assert heavy.density == pytest.approx(1.2 * free.density)
    given = fit_soil.fit(rolled, DENSITY)
    assert more.angle_deg - given.angle_deg == pytest.approx(5 / free.trade_percent, rel=0.2)
    assert -1 < free.correlation < -0.7 and given.correlation == 0
    assert given.angle_spread_deg < free.angle_spread_deg and given.density_spread is None


def test_noise_is_in_the_spread(rolled):
    rng, off = np.random.default_rng(0), []
    for _ in range(20):
        noisy = [
            again(r, r.force + 0.3 * np.abs(r.force).mean(axis=0) * rng.normal(size=(FRAMES, 3)))
            for r in rolled
        ]
        found, given = fit_soil.fit(noisy), fit_soil.fit(noisy, DENSITY)
        assert not found.reasons and not given.reasons
        assert abs(found.angle_deg - ANGLE) < 3 * found.angle_spread_deg
        off.append((given.angle_deg - ANGLE) / given.known_spread_deg)
    # White noise is all that there is, so what the curvature says is how far the angle is off.
    assert 0.6 < np.std(off) < 1.6


def test_what_is_independent_of_a_series():
    rng = np.random.default_rng(1)
    white = rng.normal(size=20_000)
    assert fit_soil._independent(white) == pytest.approx(20_000, rel=0.1)
    red = np.zeros(20_000)
    for k in range(1, len(red)):  # autoregressive: (1 - a) / (1 + a) of them
        red[k] = 0.9 * red[k - 1] + white[k]
    assert fit_soil._independent(red) == pytest.approx(20_000 * 0.1 / 1.9, rel=0.2)


def test_what_tells_nothing_says_so(field, rolled):
    rng = np.random.default_rng(2)
    size = np.abs(rolled[0].force).mean()
    lost = again(rolled[0], rolled[0].dig.force + 1.2 * size * rng.normal(size=(FRAMES, 3)))
    short = np.full((FRAMES, 3), np.nan)
    short[100:140] = rolled[0].dig.force[100:140] * [0, 1, 0] + rng.normal(size=(40, 3)) * 30
    for one, why in (
        (again(rolled[0], short), 'fit alike|comes nearer|fits best'),
        (lost, 'fit alike|comes nearer'),
        (again(rolled[0], 1e-3 * rolled[0].dig.force), 'force in N'),
        (again(rolled[0], -rolled[0].dig.force), 'soil on the tool was expected'),
        (Rolled(field, dig(field, angle=46.0)), 'largest angle fits best.*was taught'),
        (Rolled(field, dig(field, angle=20.0)), 'least angle fits best'),
    ):
        found = fit_soil.fit([one])
        assert found.angle_deg is None and found.density is None
        assert re.search(why, ' '.join(found.reasons)), found.reasons
        assert 'cannot tell' in str(found)


def test_a_tool_in_the_air_and_an_unknown_one(field):
    one = dig(field)
    above = dataclasses.replace(one, pose=one.pose + [0, 0.2, 0, 0, 0, 0, 0])
    found = fit_soil.fit([Rolled(field, above)])
    assert 'frames with a force in the soil' in found.reasons[0] and not found.curves
    thick = dataclasses.replace(one, tool=Blade(width=0.4, radius=0.03))
    found = fit_soil.fit([Rolled(field, thick)])
    assert found.angle_deg is None and 'radius' in ' '.join(found.reasons)


def test_what_is_refused(field, rolled):
    with pytest.raises(ValueError, match='no digs'):
        fit_soil.fit([])
    with pytest.raises(ValueError, match='density is 2'):
        fit_soil.fit(rolled, 2.0)
    jump = rolled[0].dig.pose.copy()
    jump[90:, 0] -= 3.0
    with pytest.raises(ValueError, match='run 0.05 0.1: the pose jumps'):
        Rolled(field, dataclasses.replace(rolled[0].dig, pose=jump))


def test_the_command(tmp_path, digs):
    """Rows of 20 Hz, in a file."""
    rows = ['time_s,run,x_m,y_m,angle_deg,force_x_N,force_y_N']
    for number, one in enumerate(digs[:2]):
        for k in range(0, FRAMES, 3):
            part = one.force[max(k - 2, 0) : k + 1].mean(axis=0)
            pose = one.pose[k]
            rows.append(f'{one.times[k]},dig {number},{pose[0]},{pose[1]},0,{part[0]},{part[1]}')
    file, out, picture = tmp_path / 'digs.csv', tmp_path / 'soil.json', tmp_path / 'soil.png'
    file.write_text('\n'.join(rows))

    def called(*more):
        command = 'learning_to_simulate.cli', 'fit-soil', str(file), f'--output_path={out}'
        return call_command(*command, *more)

    done = called('--tool=width=0.4', f'--picture={picture}')
    assert done.returncode == 0, done.stderr
    kept = json.loads(out.read_text())
    assert kept['angle_deg'] == pytest.approx(ANGLE, abs=0.3)
    assert kept['density'] == pytest.approx(DENSITY, rel=0.05)
    assert f'friction angle {kept["angle_deg"]:.1f} +-' in done.stdout
    assert picture.read_bytes()[:4] == b'\x89PNG'
    done = called('--tool=width=0.4', '--cases=1')
    assert done.returncode == 1 and 'all runs of a CSV file are taken' in done.stderr
    file.write_text('\n'.join(rows).replace('force_y_N', 'weight'))
    done = called('--tool=depth=0.4')
    assert done.returncode == 1 and 'names are' in done.stderr and 'Traceback' not in done.stderr
