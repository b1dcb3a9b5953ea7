"""A tool on its way: scaled scenes, and soil that is kept. Turned scenes, and what several tools do
to a terrain, are held against C in `native/test_soil_engine`."""

import numpy as np
import pytest

from learning_to_simulate.soil_field import network, sweep
from learning_to_simulate.soil_field import passage as passage_lib
from learning_to_simulate.soil_field.passage import AHEAD, Passage
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Blade, Soil, Wheel
from tests.learning_to_simulate.soil_field import scenes
from tests.learning_to_simulate.soil_field.scenes import DT, PATH, poses, walk

TOOLS = {'blade': Blade(0.3), 'wheel': Wheel(0.1, 0.1, 8, 0.01)}


@pytest.fixture(params=TOOLS)
def tool(request):
    return TOOLS[request.param]


def path_of(tool, start=0.0, end=None):
    """`PATH`, or a way in the soil at one height; of the circle's centre."""
    if end is None:
        return PATH + [0.0, 0.08 * (tool.name == 'wheel'), 0.0]
    u = np.linspace(start, end, 1 + int(round(abs(end - start) / 0.04)))
    return np.stack([u, 0 * u - 0.03 + tool.radius, 0 * u], axis=1)


def trench(passage, places):
    """The rise of soil that vanishes where the tool has been."""
    s = passage.state
    middle = len(s.profile) // 2
    cut = np.interp(places[:, 0], sweep.OFFSETS, (s.profile - s.surface)[middle])
    half = passage.tool.width / passage.scale / 2
    return np.where(np.abs(places[:, 1]) < half, cut, 0.0)


def level(size=(4.0, 1.6), grade=0.0, **more):
    """It reaches from x = -3 to 1, the middle is at z = 0, and it rises along the way, to -x."""
    made = Terrain.flat(size, corner=(-3.0, -size[1] / 2), **more)
    made.heights[:] = -grade * made.middles[0][:, None]
    return made


def test_on_a_long_way_a_passage_is_renewed_where_new_soil_is_cut():
    tool = TOOLS['blade']
    way = np.linspace(0.0, 1.4, 71)
    way = np.stack([way, np.full(71, tool.radius - 0.03), 0.2 + 0 * way], axis=1)
    back, up = way[:40:-1], way[40:41] + [0.0, 0.2, 0.0]
    soil, old = level(), None
    passage = Passage(soil, tool, poses(way)[0], trench)
    for pose in poses(np.concatenate([way[1:], back, up])):
        passage.step(pose, DT)
        if passage.is_due:
            old, passage = passage, passage.renewed(pose)
            assert tool.renewed_after < old.state.way < tool.renewed_after + 0.03
            assert not passage.is_due and passage.place is old.place
            assert (passage.state.memory == old.state.memory).all()
            assert passage.state.speed == old.state.speed
            at_tool = np.argmin(np.abs(sweep.OFFSETS))  # its trench is terrain by now
            surface = passage.state.surface[passage.strips.under][:, at_tool - 20 : at_tool]
            assert surface.min() > -0.031 and surface.max() < -0.02
            assert len(passage.gone) and not np.isin(passage.gone, passage.surroundings()[0]).any()
    # Twice on 1.4 m; neither on the way back nor in the air.
    assert old is not None and passage.state.way > tool.renewed_after and not passage.is_due
    assert old.state.foremost.max() == pytest.approx(1.12, abs=0.03)
    assert np.isinf(TOOLS['wheel'].renewed_after)


@pytest.mark.parametrize(
    'one, other',
    [
        (Blade(0.6), Blade(1.2, 0.028, 0.554)),
        (Wheel(0.1, 0.1, 8, 0.01), Wheel(0.2, 0.2, 8, 0.02)),
    ],
)
def test_a_scene_of_twice_the_size_is_the_same_in_other_units(one, other):
    path = path_of(one)
    here, frames = walk(scenes.hills(), one, poses(path))
    large, dt = scenes.hills(scale=2.0), np.sqrt(2.0) * DT
    if 'stress' in one.scalars:  # and grains as stiff against the soil's weight
        large, dt = large.clone(Soil(gravity=9.81 / 2)), 2.0 * DT
    there, others = walk(large, other, poses(path * [2, 2, 1]), dt)
    scenes.assert_frames(others, frames)
    assert there.scale == 2 * here.scale == 2
    for a, b in zip(there.surroundings(), here.surroundings()):
        np.testing.assert_allclose(a, b * (2 if b.ndim == 1 and b.dtype == float else 1))


@pytest.mark.parametrize('grade', [0.02, -0.26])
def test_an_even_slope_is_seen_as_level_ground(tool, grade):
    """All but gravity is as on level ground, turned as a whole; a renewed passage stays laid."""
    path, angle = path_of(tool), np.arctan(grade)
    here, frames = walk(level(), tool, poses(path), rise=trench)
    c, s = np.cos(angle), np.sin(angle)
    u, y, lean = path.T
    path = np.stack([c * u - s * y, s * u + c * y, lean + angle], axis=1)
    slope = level(grade=grade)
    there, others = walk(slope, tool, poses(path), rise=trench)
    scenes.assert_frames(others, frames)
    assert there.place.grade == pytest.approx(grade) and here.place.grade == 0
    assert there.slope == pytest.approx(0.0, abs=1e-9)
    assert there.crossfall == pytest.approx(0.0, abs=1e-9)
    here.update(), there.update()
    risen = slope.heights + grade * slope.middles[0][:, None]
    # Of (20): what is cut here; on places of the map, whose ways are shorter by the cosine.
    dug = here.terrain.heights.sum()
    assert risen.sum() == pytest.approx(dug, rel=0.02) and dug < -0.5
    assert there.renewed(poses(path)[-1]).place is there.place
    load = there.place.unlaid([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(load @ load.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(load[1] @ [1.0, -grade, 0.0], 0.0, atol=1e-15)


def test_a_tool_that_is_set_down_uphill_has_not_turned_back():
    slope, tool = level(grade=0.26), TOOLS['blade']
    path = [[0.0, y, 0.2] for y in np.arange(0.3, -0.04, -0.02)]
    passage, _ = walk(slope, tool, poses(path), rise=trench)
    assert passage.place.grade and sweep.all_cut(passage.state).any()
    back = passage.state.foremost.max() - passage.state.tip
    assert 0 <= back < 0.02


def test_what_is_remembered_is_seen_from_a_new_ground():
    tool, soil = TOOLS['wheel'], level()
    passage, _ = walk(soil, tool, poses([[0.0, 0.08, 0.0], [0.1, 0.09, 0.1]]))
    old = passage.state.memory
    passage.state = passage.state._replace(
        surface=passage.state.surface + 0.2 * (passage.state.origin + sweep.OFFSETS)
    )
    other = passage.renewed(poses([[0.1, 0.09, 0.1]])[0])
    assert other.place.grade == pytest.approx(0.2)
    new = other.state.memory
    np.testing.assert_allclose(new[:, 2:], old[:, 2:])
    turned = (old[:, 0] + 1j * old[:, 1]) * np.exp(-1j * np.arctan(0.2))
    np.testing.assert_allclose(new[:, 0] + 1j * new[:, 1], turned)


def test_ground_that_is_too_steep_as_a_whole_is_said():
    passage = Passage(level(grade=0.25), TOOLS['blade'], poses([[0.0, 0.1, 0.0]])[0])
    assert passage.place.grade == pytest.approx(0.25) and abs(passage.slope) < 1e-9
    more = 0.05 * (passage.state.origin + sweep.OFFSETS)
    passage.state = passage.state._replace(surface=passage.state.surface + more)
    assert passage.slope == pytest.approx(0.3 / (1 - 0.0125))


@pytest.mark.parametrize('grade, bump', [(0.009, 0.0), (0.3, 0.0), (0.15, 0.03)])
def test_a_slope_that_is_flat_steep_or_uneven_is_not_seen_as_level(grade, bump):
    slope = level(grade=grade)
    slope.heights[:] += bump * np.exp(-((slope.middles[0][:, None] + 0.3) ** 2) / 0.01)
    passage = Passage(slope, TOOLS['blade'], poses([[0.0, 0.1, 0.0]])[0])
    assert passage.place.grade == passage.place.height == 0.0
    assert passage.slope == pytest.approx(grade, abs=0.03)


def test_a_frame_holds_place_speed_and_wall_in_units_of_the_field():
    tool, soil = Wheel(0.1, 0.2), level(walled=True, floor=0.0)
    passage, frames = walk(soil, tool, poses([[0.0, 0.4, 0.0], [0.06, 0.4, -0.1]]), set_down=False)
    seen = dict(zip(network.names_of(tool), frames[1].scalars[0, 0].tolist()))
    assert passage.scale == 2 and seen['tip'] == pytest.approx(0.03)
    assert seen['below'] == pytest.approx(0.1)
    assert seen['height'] == pytest.approx(0.2) and seen['ahead'] == pytest.approx(AHEAD)
    # On the way of 0.03 the rim turned by 0.1 * 0.1: it slides by 0.02.
    assert seen['behind'] == pytest.approx(0.53)
    assert seen['way'] == pytest.approx(0.05)
    assert seen['speed'] == pytest.approx(0.05 / DT * np.sqrt(2.0), rel=1e-6)
    for u in (0.9, 1.7, 2.5):
        passage.step(poses([[u, 0.4, 0.0]])[0], DT)
    ahead, behind = (network.names_of(tool).index(name) for name in ('ahead', 'behind'))
    assert passage.frame.scalars[0, 0, ahead] == pytest.approx(0.25)
    assert passage.frame.scalars[0, 0, behind] == pytest.approx(AHEAD)  # farther away
    assert passage.frame.scalars[0, 0, sweep.SCALARS.index('tip')] == pytest.approx(0.25)


def test_a_tool_is_set_down_from_above_or_stands_in_soil_as_it_is():
    first = poses([[0.1, -0.04, 0.2]])[0]
    fresh = Passage(scenes.hills(), TOOLS['blade'], first, set_down=False)
    assert fresh.state.way == 0 and not fresh.frame.bins[..., sweep.CUT].any()
    down = Passage(scenes.hills(), TOOLS['blade'], first, trench)
    s = down.state
    circle = s.pose[1] - np.sqrt(np.maximum(0.014**2 - sweep.OFFSETS**2, 0.0))
    wanted = np.where(np.abs(sweep.OFFSETS) <= 0.014, np.minimum(s.surface, circle), s.surface)
    np.testing.assert_allclose(s.profile, wanted, atol=1e-14)
    np.testing.assert_allclose(s.memory[0, :3], [0.0, -1.0, 0.0])
    np.testing.assert_allclose(s.memory[0, 3], s.way)  # in 1 s
    assert s.surface.max() + 0.014 + 0.049 < s.way - 0.04 < s.surface.max() + 0.1
    before = down.terrain.heights.copy()
    down.update()
    assert (down.terrain.heights < before).any()
    # In the air it stays where it is.
    air = Passage(scenes.hills(), TOOLS['blade'], poses([[0.1, 0.5, 0.0]])[0])
    assert air.state.way == 0


def test_a_clone_remembers_alone():
    """What others dig in the terrain of the one is news to it and nothing to the other."""
    tool, soil = TOOLS['blade'], level()
    passage, _ = walk(soil, tool, poses(path_of(tool, 0.0, 0.3)), rise=trench)
    passage.update()
    other = passage.clone(soil.clone())
    cells, _, before = passage.surroundings()
    before = before.copy()
    other.terrain.write(cells, other.terrain.heights.ravel()[cells] - 0.01)
    other.meet()
    np.testing.assert_allclose(other.surroundings()[2], before - 0.01, atol=1e-15)
    np.testing.assert_array_equal(passage.surroundings()[2], before)
    passage.meet()
    np.testing.assert_array_equal(passage.surroundings()[2], before)


def test_a_step_that_is_too_long_is_refused_and_changes_nothing(tool):
    """All other poses and times are refused before, see `native/test_soil_engine`."""
    pose = poses(path_of(tool))
    (passage, _), (fresh, _) = (walk(scenes.hills(), tool, pose[:4], rise=trench) for _ in 'ab')
    with pytest.raises(ValueError, match='within one frame'):
        passage.step(pose[4] - [0.5, 0, 0, 0, 0, 0, 0], DT)
    for p in (passage, fresh):
        p.step(pose[4], DT)
    scenes.assert_frames([passage.frame], [fresh.frame], atol=0)


def piled(share):
    """As `trench`, with a part of what vanishes on either side of the tool."""

    def rise(passage, places):
        cut = trench(passage, places)
        half = passage.tool.width / passage.scale / 2
        beside = (np.abs(places[:, 1]) > half) & (np.abs(places[:, 1]) < 2 * half)
        s = passage.state
        depth = (s.surface - s.profile)[len(s.profile) // 2]
        depth = np.interp(places[:, 0], sweep.OFFSETS, depth)
        return np.where(beside, share * depth, cut)

    return rise


@pytest.mark.parametrize('share', [0.6, 1.7])
@pytest.mark.parametrize('strips', ['one', 'all'])
def test_soil_is_kept_on_a_way_of_any_length(tool, share, strips, monkeypatch):
    """As much rises on both sides together as vanishes between, whatever the rise says."""
    soil, scale = level(), tool.scale
    path = path_of(tool, 0.0, 0.8) if tool.name == 'wheel' else path_of(tool, 0.0, 2.1)
    if strips == 'all':
        monkeypatch.setattr(passage_lib, 'EVEN', -1.0)
    passage, _ = walk(soil, tool, poses(path), rise=piled(share))
    passage.update()
    cell = np.prod(soil.cell)
    assert soil.heights.min() == pytest.approx(-0.03, abs=1e-9)
    moved = cell * np.maximum(-soil.heights, 0).sum()
    assert abs(cell * soil.heights.sum()) < 1e-9 * moved
    # Nothing is carried but what lies about the tool.
    if tool.name == 'blade':
        x, _ = soil.middles
        local = -x[:, None] - passage.state.origin
        gone = np.broadcast_to(local < sweep.OFFSETS[0], soil.heights.shape)
        left = cell * soil.heights[gone].sum() / scale**3
        carried = passage.state.dropped.mean() + 0.03 * 0.005 * (passage.state.profile < 0)[0].sum()
        wanted = carried - left / (tool.width / scale) - passage.state.dropped.mean()
        np.testing.assert_allclose(passage.carried.mean(), wanted, atol=2e-3)


def test_a_lifted_tool_leaves_the_soil_as_it_is(tool):
    def rise(passage, places):
        return trench(passage, places) * (1.0 - passage.state.pose[1])

    soil, over = level(), tool.radius / tool.scale + tool.lifted
    passage, _ = walk(soil, tool, poses(path_of(tool, 0.0, 0.4)), rise=rise)

    def go(u, height):
        pose = poses([[u, tool.scale * (over + height), 0.0]])[0]
        assert passage.lifts(passage.seen(pose)) == (height > 0)
        passage.step(pose, DT)
        return soil.heights.copy()

    soil.add_work(passage)
    low = go(0.4, -1e-3)
    assert low.min() < -0.015 and not (passage.is_lifted or passage.is_over)
    for u, height in ((0.4, 1e-3), (0.42, 0.1), (0.8, 0.3), (0.6, 0.3)):
        np.testing.assert_array_equal(go(u, height), low)
        assert passage.is_over
    back, ahead = (poses([[u, tool.radius + 1e-3, 0.0]])[0] for u in (0.37, 0.39))
    assert passage.lifts(passage.seen(back)) and not passage.lifts(passage.seen(ahead))
    # Over a heap it is nearer, and where it comes down heights follow it again.
    heap, near = soil.clone(), poses([[0.0, tool.scale * (over + 0.02), 0.0]])[0]
    heap.write(slice(None), soil.heights.ravel() + 0.03)
    assert Passage(soil, tool, near).is_lifted and not Passage(heap, tool, near).is_lifted
    assert (go(0.6, -1e-3) != low).any()
    passage, _ = walk(level(), tool, poses([[0.0, 1.0, 0.0], [0.1, 1.0, 0.0]]), rise=rise)
    assert passage.is_lifted and not passage.is_over


def test_soil_that_leaves_the_map_is_not_made_up_for():
    tool, soil = TOOLS['blade'], level((4.0, 0.5))
    passage, _ = walk(soil, tool, poses(path_of(tool, 0.0, 0.4)), rise=piled(0.6))
    passage.update()
    assert soil.heights.max() == pytest.approx(0.6 * 0.03, abs=1e-9)
    soil = level((4.0, 0.5), walled=True)
    passage, _ = walk(soil, tool, poses(path_of(tool, 0.0, 0.4)), rise=piled(0.6))
    passage.update()
    assert soil.heights.max() > 0.03
