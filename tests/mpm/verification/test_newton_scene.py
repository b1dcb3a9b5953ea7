"""The scene as Newton gets it; where Newton is installed, a bed that rests and is pushed."""

import dataclasses
import sys

import numpy as np
import pytest

from mpm import bodies, packing, scenes
from mpm.constitutive import make_soil
from mpm.contact import signed_distances
from mpm.motions.drive import Drive
from mpm.verification import newton_scene

BOX = scenes.EXCAVATION.bin


def test_soil_is_mapped_by_definition():
    found = newton_scene.material_of(make_soil(1.5e6, 0.76, 0.25)._asdict())
    assert found == pytest.approx(
        {'density': 2583 * 0.67, 'young_modulus': 1.5e6, 'poisson_ratio': 0.25, 'friction': 0.76}
    )


def test_blade_is_the_closed_shape_of_the_solver():
    blade = bodies.make_blade(BOX.z_middle)
    vertices, triangles = newton_scene.blade_mesh(blade)
    edges = {(t[i], t[(i + 1) % 3]) for t in triangles.tolist() for i in range(3)}
    assert len(edges) == 3 * len(triangles) and {(b, a) for a, b in edges} == edges
    p = vertices[triangles]
    volume = np.einsum('ij,ij->', p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6
    area = 2 * blade.radius * blade.length + np.pi * blade.radius**2
    assert volume == pytest.approx(2 * blade.half_width * area, rel=2e-3)
    placed = vertices + [0.0, 0.0, blade.z_middle]
    assert np.abs(signed_distances(blade, (0.0, 0.0, 0.0), placed)).max() < 1e-12


def test_box_is_open_above_and_looks_inward():
    corners, triangles = newton_scene.bin_mesh(BOX)
    assert len(triangles) == 10
    p = corners[triangles]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    inward = corners.mean(axis=0) - p.mean(axis=1)
    assert (np.einsum('ij,ij->i', normal, inward) > 0).all()
    assert not (p[:, :, 1] == BOX.height).all(axis=1).any()


def test_transform_turns_and_shifts_as_the_solver_does():
    blade = bodies.make_blade(BOX.z_middle)
    pose = (0.5, 0.22, -0.6)
    x, y, z, *imaginary, real = newton_scene.transform_of(np.array(pose), blade.z_middle)[0]
    assert imaginary[:2] == [0, 0]
    twice = 2 * np.arctan2(imaginary[2], real)
    turn = np.array([[np.cos(twice), -np.sin(twice)], [np.sin(twice), np.cos(twice)]])
    points = blade.points.copy()
    points[:, :2] = points[:, :2] @ turn.T
    expected = bodies.sample_points(blade, *pose) - scenes.CORNER
    np.testing.assert_allclose(points + [x, y, z], expected, atol=1e-7)


def test_without_newton_the_error_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, 'newton', None)
    with pytest.raises(ValueError, match='newton is not installed.*pip install newton usd-core'):
        newton_scene.imported()


def test_a_plate_under_the_bed_feels_its_weight_and_a_push_is_balanced():
    """The plate is a blade on its side that covers the floor of a small box."""
    pytest.importorskip('newton')
    pytest.importorskip('pxr')
    box = dataclasses.replace(BOX, size=(0.16, 0.04, 0.16), lattice=(16, 4, 16), height=0.2)
    plate = bodies.make_blade(scenes.CORNER + 0.08, 0.24)._replace(length=0.24, radius=0.02)

    def pose(times):
        moved = 0.05 * np.maximum(times, 0.0)
        rest = np.full((len(times), 2), [scenes.CORNER, -np.pi / 2])
        return np.column_stack([scenes.CORNER - 0.04 - moved, rest])

    positions = packing.lattice(box, 0)[:, :3] + [0.0, 0.02, 0.0]
    material = newton_scene.material_of(make_soil(1.5e6, 0.76)._asdict())
    particles = (positions, packing.particle_volume(box))
    rigid = newton_scene.Numerics(0.02, 2, rigid=True)
    bed = newton_scene.NewtonBed(box, Drive(plate, pose), material, particles, rigid)
    for frame in range(-6, 0):
        on_plate, on_box, missing = bed.frame(frame / 60)
    assert -(on_plate + on_box)[1] == pytest.approx(bed.weight, rel=0.01)
    assert -on_plate[1] > 0.7 * bed.weight  # the rest hangs on the sticky walls
    assert np.abs(missing).max() < 0.01 * bed.weight
    made = newton_scene.run_in_newton(bed, 3)
    assert made.force.shape == (3, 3) and made.positions.shape == positions.shape
    # The plate is drawn to -x: friction drags it back, at most by 0.3 of the normal force.
    assert 0.1 < made.force[-1, 0] / -made.force[-1, 1] < 0.31
    assert made.unbalanced < 0.01 and made.floor_over_weight < 0.3
