"""The ROS 2 examples, built and run without ROS: stand-ins of its headers print what is sent."""

import os
import pathlib
import shutil
import subprocess

import numpy as np
import pytest

from learning_to_simulate.live.soil import Particles
from learning_to_simulate.native import engines, library, soil_data
from learning_to_simulate.soil_field.stepper import SoilStepper
from learning_to_simulate.soil_field.terrain import Terrain
from tests.learning_to_simulate.native import worlds
from tests.learning_to_simulate.soil_field.scenes import poses

STAND_IN = pathlib.Path(__file__).with_name('ros_stand_in')
COMPILERS = [x for x in map(shutil.which, ('g++', 'clang++')) if x]
PATH = [(0.0, 0.03, 0.0), *((0.01 * k, 0.03 - 0.004 * k, 0.0) for k in range(1, 20)), (1.5, 0.3, 0)]

pytestmark = pytest.mark.skipif(not COMPILERS, reason='no C++ compiler')


def to_ros(values):
    """The model's y up as z up."""
    values = np.asarray(values)
    return np.stack([values[..., 0], -values[..., 2], values[..., 1]], axis=-1)


def sent(tmp_path, values, way):
    """Kind -> words of each message that the node of a project, built without a remark, sends for
    poses [T, 7]."""
    folder = worlds.written(tmp_path / 'project', 'lts_small', values)
    built, program = str(tmp_path / 'lib.so'), str(tmp_path / 'node')
    library.compile_sources(built, *library.parts_of(folder))
    strict = ['-std=c++17', '-Wall', '-Wextra', '-Werror']
    source = os.path.join(folder, 'examples', 'ros2_node.cpp')
    subprocess.run(
        [COMPILERS[0], *strict, f'-I{STAND_IN}', f'-I{folder}/include', source, built,
         '-o', program], check=True,
    )  # fmt: skip
    lines = '\n'.join(
        ' '.join(f'{x:.17g}' for x in (*to_ros(p[:3]), p[3], *to_ros(p[4:]))) for p in way
    )
    done = subprocess.run([program], input=lines, capture_output=True, text=True, check=True)
    found = {}
    for kind, *words in map(str.split, done.stdout.splitlines()):
        found.setdefault(kind, []).append(words)
    return found


def assert_wrench(found, force, torque, share):
    """Of forces [T, 3] and torques about the origin, both with y up, to a share of the largest."""
    wanted, atol = (
        np.concatenate([to_ros(force), to_ros(torque)], axis=1),
        share * np.abs(force).max(),
    )
    np.testing.assert_allclose(np.array(found['wrench'], float), wanted, atol=atol)
    assert ' '.join(found['status'][0]) == '0 within the training runs'


def test_the_node_sends_what_the_stepper_says(tmp_path):
    model, _, starts, values = worlds.graph(tmp_path / 'data')
    live, pose = engines.stepper(model, starts, worlds.space(), 'c'), starts.pose[0]
    path = [pose + [-8e-4 * k, -8e-4 * k, 0, 0, 0, 0, 0] for k in range(1, 11)]
    path.append(pose + [50, 0, 0, 0, 0, 0, 0])  # a jump: unlike the training runs
    # The library's poses are of the middle of the nodes; the body does not turn here.
    middle = starts.body[0][starts.kept[0]].mean(axis=0)
    found = sent(tmp_path, values, np.array(path) + np.append(middle, [0, 0, 0, 0]))
    assert {kind: len(rows) for kind, rows in found.items()} == dict.fromkeys(
        ('wrench', 'cloud', 'map', 'status'), len(path)
    )
    live.start(pose)
    frames = [live.step(p) for p in path]
    force = np.array([frame.force for frame in frames])
    points = np.array([frame.rigid_pose.mean(axis=0) for frame in frames])
    assert_wrench(found, force, np.cross(points, force), 1e-4)
    for k in (0, 9):
        soil = to_ros(frames[k].particles())
        count, size, *last = map(float, found['cloud'][k])
        assert (count, size) == (len(soil), 12 * len(soil))
        np.testing.assert_allclose(last, soil[-1], atol=1e-5)
        cell, x, y, nx, ny, *heights = map(float, found['map'][k])
        nx, ny = int(nx), int(ny)
        half = cell / 2 * np.array([nx, ny, 0])
        corners = np.array([x, y, 0]) + [-half, half]
        ours = Particles(corners, 2).height_map(soil, nx, ny)
        # Cell (0, 0) of grid_map is at the largest x and y.
        theirs = np.reshape(heights, (ny, nx)).T[::-1, ::-1]
        np.testing.assert_allclose(ours, theirs, atol=1e-5)
    assert found['status'][-1][0] in '12'


def test_the_node_of_a_soil_field_sends_what_the_stepper_says(tmp_path):
    field = worlds.soil_field('blade', worlds.TINY)
    found = sent(tmp_path, soil_data.values(field), way := poses(PATH))
    terrain = Terrain.flat((4.0, 2.0), corner=(-2.0, -1.0))
    live, frames = SoilStepper(field, terrain, engine='c'), []
    live.start(way[0])
    for pose in way[:-1]:
        frames.append(live.step(pose, 1 / 60))
    force, torque = (np.array([getattr(f, name) for f in frames]) for name in ('force', 'torque'))
    assert np.abs(force).max() > 1
    torque += np.cross([frame.pose[:3] for frame in frames], force)
    assert_wrench(found, force, torque, 1e-6)
    cell, x, y, nx, ny, *heights = map(float, found['map'][-1])
    assert (cell, x, y, nx, ny) == (0.02, 0, 0, 200, 100)
    # Cell (0, 0) of grid_map is at the largest x and y, which is the least z.
    theirs = np.reshape(heights, (100, 200)).T[::-1]
    np.testing.assert_allclose(theirs, terrain.heights, atol=1e-6)
    assert np.ptp(theirs) > 1e-4
    assert found['status'][-1][0] == '2'
