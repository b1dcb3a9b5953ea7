"""What a tool has swept, against a circle that is drawn in fine steps. Bins that follow the tool,
and both cones, are held against C in `native/test_soil_engine`."""

import numpy as np
import pytest

from learning_to_simulate.soil_field import sweep
from tests.learning_to_simulate.soil_field.scenes import DT

RADIUS = 0.0193  # no bin lies at the very end of the circle
STRIKES = 0.04
# Down, along, back, up, back over the terrain and down again; lean as it comes.
PATH = np.array(
    [[0.003, 0.05, 0.0], [0.021, 0.0, 0.1], [0.06, -0.03, 0.3], [0.142, -0.05, 0.2],
     [0.253, -0.02, 0.1], [0.2, -0.04, 0.2], [0.252, -0.05, 0.3], [0.271, 0.06, 0.3],
     [0.14, 0.055, 0.2], [0.01, 0.05, 0.2], [-0.05, 0.03, 0.1], [-0.07, -0.01, 0.1]]
)  # fmt: skip
TURN = 0.1 * np.diff(PATH[:, 2])


def ground(u):
    """Heights of two strips."""
    return np.stack([0.01 * np.sin(9 * u), 0.01 * np.cos(5 * u) - 0.02])


def level(u):
    return np.zeros((1, len(u)))


def run(path, turn, read=ground):
    """All states along poses [T, 3]."""
    states = [sweep.start(path[0], read)]
    for pose, x in zip(path[1:], turn, strict=True):
        states.append(sweep.advance(states[-1], pose, x, RADIUS, DT, read, STRIKES))
    return states


def drawn(path, turn, n=2000):
    """The twin: the circle put down at n places of every frame. A dict for each frame."""
    u = path[0, 0] + sweep.OFFSETS
    surface = ground(u)
    profile, foremost, way = surface.copy(), np.full(2, path[0, 0]), 0.0
    last, before = np.full(surface.shape, -np.inf), np.zeros_like(surface)
    struck, begun, layer = np.zeros_like(surface), np.zeros((2, 1)), np.zeros(2)
    motions, travelled, found = [], 0.0, []
    for a, b, x in zip(path[:-1], path[1:], turn):
        place = np.linspace(a[:2], b[:2], n)
        area = ((surface - profile) * (np.abs(u - a[0]) < sweep.WINDOW)).sum(axis=1) * 0.005
        square = RADIUS**2 - (u - place[:, :1]) ** 2
        e = np.where(square >= 0, place[:, 1:] - np.sqrt(np.abs(square)), np.inf).min(axis=0)
        new = np.minimum(profile, e)
        before = np.where((new < surface) & (profile == surface), area[:, None], before)
        begun = np.maximum(begun, np.minimum((surface - new).max(axis=1) / 0.002, 1)[:, None])
        over = np.maximum(struck, begun * np.clip(surface + STRIKES - e, 0, STRIKES))
        is_new = (over > 0) & (struck == 0) & (new == surface)
        before = np.where(is_new, np.maximum(area - layer, 0)[:, None], before)
        struck = over
        thick = np.where(struck > 0.002, STRIKES - struck, struck / 0.002 * (STRIKES - struck))
        shallow = 1 - np.minimum((surface - new) / 0.002, 1)
        layer = 0.005 * (shallow * thick).sum(axis=1)
        travelled += np.linalg.norm(b[:2] - a[:2])
        last = np.where(e < surface, travelled, last)
        share = np.clip((surface - e).max(axis=1) / 1e-4, 0, 1)
        foremost = np.maximum(foremost, foremost + share * (b[0] - foremost))
        # Motions and lengths of small pieces.
        ds = np.linalg.norm(b[:2] - a[:2]) + abs(x)
        motions += [(ds / n, np.array([*(b[:2] - a[:2]), x, ds**2 / DT]) / ds)] * n
        profile, way = new, way + ds
        found.append(
            {'profile': profile, 'since': np.minimum(travelled - last, sweep.FORGET), 'way': way,
             'area_before': before, 'foremost': foremost, 'memory': memory(motions),
             'speed': ds / DT, 'cut': surface - profile, 'struck': struck, 'layer': layer}
        )  # fmt: skip
    return found


def memory(motions):
    """(7) as an integral over the way that lies behind."""
    lengths, d = np.array([m[0] for m in motions]), np.array([m[1] for m in motions])
    behind = np.cumsum(lengths[::-1])[::-1] - lengths / 2
    return np.stack(
        [(lengths / m * np.exp(-behind / m))[:, None].T @ d for m in sweep.MEMORIES]
    )[:, 0]  # fmt: skip


def test_a_sweep_is_that_of_a_circle_drawn_along_the_path():
    states, wanted = run(PATH, TURN)[1:], drawn(PATH, TURN)
    for state, want, pose in zip(states, wanted, PATH[1:], strict=True):
        bins, own = sweep.channels(state, 0.1), sweep.scalars(state, 0.1)
        np.testing.assert_allclose(bins[..., sweep.SURFACE], state.surface - 0.1, atol=1e-7)
        # Where the circle stands upright at the end of a swath, the drawn one misses by a step.
        wrong = np.abs(state.profile - want['profile'])
        assert np.sort(wrong, axis=1)[:, -5].max() < 1e-5
        assert (state.profile <= want['profile'] + 1e-12).all()
        np.testing.assert_allclose(bins[..., sweep.CUT], want['cut'], atol=wrong.max() + 1e-7)
        close = wrong < 1e-5
        # A place that is hardly cut counts as passed by its share.
        share = np.minimum(want['cut'] / 0.002, 1.0)
        want['since'] = sweep.FORGET - share * (sweep.FORGET - want['since'])
        for name in ('since', 'area_before', 'struck'):
            found = bins[..., sweep.CHANNELS.index(name)]
            bound = 2e-5 if name != 'since' else 2e-5 + wrong[close].max() / 0.002
            np.testing.assert_allclose(found[close], want[name][close], atol=bound)
        np.testing.assert_allclose(sweep.layer(state, STRIKES), want['layer'], atol=5e-5)
        seen = dict(zip(sweep.SCALARS, own.T, strict=True))
        place = np.stack([seen[name] for name in ('tip', 'height', 'lean')], axis=1)
        np.testing.assert_allclose(place, [pose - [PATH[0, 0], 0.1, 0.0]] * 2, atol=1e-6)
        assert seen['way'] == pytest.approx(want['way'], rel=1e-6)
        assert seen['speed'] == pytest.approx(want['speed'], rel=1e-6)
        np.testing.assert_allclose(seen['foremost'], want['foremost'] - PATH[0, 0], atol=1e-6)
        np.testing.assert_allclose(seen['area'], 0.005 * want['cut'].sum(axis=1), atol=2e-5)
        # Of order one, but for the pace of 6 m/s.
        size = np.where(np.array(sweep.MOTIONS) == 'pace', want['speed'], 1.0)
        for found in (own[0, 7:].reshape(want['memory'].shape), state.memory):
            np.testing.assert_allclose(found / size, want['memory'] / size, atol=2e-3)
    assert states[-1].profile.min() < -0.065 and (wanted[-1]['area_before'] > 1e-3).sum() > 10
    assert wanted[-1]['layer'].min() > 5e-4 and states[-1].begun.min() == 1


def test_a_tool_that_touches_the_soil_takes_its_foremost_place_along_without_a_jump():
    def foremost(depth):
        """After 5 mm over the soil, down to so deep in it at a bin's centre."""
        state = sweep.start(np.array([0.0, RADIUS + 0.01, 0.0]), level)
        pose = np.array([0.005, RADIUS - depth, 0.0])
        return sweep.advance(state, pose, 0.0, RADIUS, DT, level).foremost[0]

    assert foremost(-1e-6) == pytest.approx(0.0, abs=1e-15)
    assert foremost(1e-6) == pytest.approx(5e-5, rel=1e-6)
    assert foremost(5e-5) == pytest.approx(2.5e-3, rel=1e-6)
    assert foremost(1e-4 + 1e-9) == foremost(0.01) == 0.005


@pytest.mark.parametrize('lean_deg', [1.0, 30.0, 59.0, 88.0, 130.0])
@pytest.mark.parametrize('depth', [0.004, 0.03, 0.11])
def test_soil_in_place_of_the_back_is_that_under_its_line(lean_deg, depth):
    """(26) of a plate that was put into level soil, which nothing has cut: a triangle, or less
    where the back ends; by a fine sum over the line itself."""
    lean, length = np.radians(lean_deg), 0.2
    tip = 0.0123
    pose = np.array([tip, RADIUS * np.sin(lean) - depth, lean])
    state = sweep.start(pose, level)
    pressed = sweep.pressed(state, RADIUS, np.pi / 2 - lean, length)
    t = (np.arange(20000) + 0.5) / 20000 * length  # along the back, from where it meets the circle
    below = np.maximum(-(pose[1] - RADIUS * np.sin(lean) + t * np.cos(lean)), 0.0)
    along = length / 20000 * np.sin(lean)
    assert pressed[0] == pytest.approx(below.sum() * along, rel=1e-3, abs=1e-9)


def test_a_back_that_follows_its_edge_meets_no_soil():
    path = np.stack([np.linspace(0.0, 0.3, 31), np.full(31, -0.02), np.full(31, 0.5)], axis=1)
    state = run(path, np.zeros(30), level)[-1]
    pressed = sweep.pressed(state, RADIUS, np.pi / 2 - 0.5, 0.2)
    np.testing.assert_allclose(pressed, 0.0, atol=1e-9)
    # Put straight down, it does; a wheel has no back.
    down = path[[0, 0, 0]] + [[0, 0.1, 0], [0, 0.05, 0], [0, -0.02, 0]]
    state = run(down, np.zeros(2), level)[-1]
    assert (sweep.pressed(state, RADIUS, np.pi / 2 - 0.5, 0.2) > 2e-4).all()
    assert not np.any(sweep.pressed(state, RADIUS, 0.0, 0.0))


def test_a_tool_that_halts_keeps_its_memory_and_one_that_turns_back_forgets():
    path = np.array([[0.0, -0.03, 0.0], [0.1, -0.03, 0.0], [0.1, -0.03, 0.0], [0.095, -0.03, 0.0]])
    states = run(path, np.zeros(3))
    np.testing.assert_array_equal(states[2].memory, states[1].memory)
    assert states[2].way == states[1].way and states[2].speed == 0
    assert states[3].memory[0, 0] == pytest.approx(-1, abs=1e-3)
    assert states[3].memory[3, 0] > 0.5


def test_ground_that_is_not_finite_is_refused():
    """Somebody may have written it into a terrain."""
    state = sweep.start(PATH[0], ground)
    with pytest.raises(ValueError, match='not finite'):
        sweep.start(PATH[0], lambda u: ground(u) * [[np.nan], [1]])
    with pytest.raises(ValueError, match='not finite'):
        sweep.advance(state, PATH[1] + 1.0, 0.0, RADIUS, DT, lambda u: ground(u) * np.nan)
