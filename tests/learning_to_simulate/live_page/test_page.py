"""The page with the extra `live`: frame by frame, and in a real browser where one is there."""

import functools
import shutil
import socket
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

import learning_to_simulate as lts
from learning_to_simulate.live_page import __main__ as command
from learning_to_simulate.live_page import drawing

viser = pytest.importorskip('viser', reason='the extra `live` is not installed')

from learning_to_simulate.live_page import gui, page  # noqa: E402

CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser')
# WebGL without a graphics card.
BROWSER = (
    '--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader',
)  # fmt: skip
session_of = functools.cache(command.session_of)


def load(name):
    session = session_of(name)
    session.reset(start=0)
    return session


def free_port():
    with socket.create_server(('localhost', 0)) as server:
        return server.getsockname()[1]


@pytest.fixture
def shown():
    """A page of the blade whose frames are computed by a thread."""
    made = page.Page(load, ['excavation'], 'excavation', port=free_port())
    thread = threading.Thread(target=made.run, daemon=True)
    thread.start()
    yield made
    made.stop()
    thread.join()


@pytest.fixture
def seen(monkeypatch):
    """A page with one browser that is looked at frame by frame, without a network."""
    made = page.Page(load, ['excavation', 'wheel', 'nothing'], 'excavation', port=free_port())
    made.notices, browser = [], SimpleNamespace(camera=SimpleNamespace())
    browser.add_notification = lambda title, text, color: made.notices.append(text)
    made.clients = {0: browser}
    monkeypatch.setattr(made.server, 'get_clients', lambda: made.clients)
    yield made
    made.stop()


def test_sliders_and_handle_move_the_tool_and_nothing_moves_without_a_browser(seen):
    session = seen.session
    seen.panel._steer('depth', 20.0)
    seen.panel._nudge('speed', 50.0)
    place = session.plane + [0.02 * session.forwards, -0.02, 0.0]
    seen.do(lambda: seen._aim(place))
    for _ in range(30):
        seen.frame()
    np.testing.assert_allclose(session.plane, place, atol=1e-9)
    np.testing.assert_allclose(seen._body.position, session.moment.pose[:3], atol=1e-6)
    points = seen._soil.points + seen._middle  # sent in half precision
    np.testing.assert_allclose(points, session.moment.particles, atol=3e-4)
    assert seen.panel.chart.data[0][-1] == pytest.approx(0.5) and seen.panel._rows[-1][1] != 0.0
    assert session.steering.sliders['speed'].value == 0.0 and 'N m' not in seen.panel._said
    assert seen.panel._sliders['depth'].value == session.steering.sliders['depth'].value != 20.0
    seen.clients.clear()
    seen._dragging = True
    seen._left(None)  # in the middle of a drag
    seen.frame()
    seen.clients[0] = 0
    seen.frame()
    assert not seen._dragging and session.moment.frame == 30 and 'paused' in seen.panel._said
    seen.pause()
    seen.frame()
    assert session.moment.frame == 31 == len(session.path()) - 1


def test_another_model_and_one_that_is_not_there(seen):
    seen.choose_model('nothing')
    assert 'nothing: no folder' in seen.notices[0] and seen.panel.model.value == 'excavation'
    seen.choose_model('wheel')
    for _ in range(6):
        seen.frame()
    session = seen.session
    assert session.scene.name == 'wheel' and {'rotation', 'slip'} < seen.panel._sliders.keys()
    assert abs(session.plane[2]) > 0.01  # it has turned, its arrow has not
    assert tuple(seen._handle.wxyz) == (1.0, 0.0, 0.0, 0.0) and 'sinkage' in seen.panel._said
    lightest = float(session.model.starts.context[:, 2].min())
    seen.panel._context('load', lightest)
    assert session.context['load'] == pytest.approx(lightest)
    run = next(iter(session.recorded.runs))
    seen.reset(run)
    seen.panel.run.value = run
    seen.frame()
    assert session.run is not None and seen._ghost.visible and len(seen.panel._rows[-1]) == 5
    seen.panel._steer('slip', 30.0)  # whoever touches the tool takes it over
    assert session.run is None and seen.panel.run.value == gui.BY_HAND and not seen._ghost.visible
    seen.reset('test 99')
    assert 'no recorded run' in seen.notices[1]


def test_lost_frames_do_not_come_at_once_and_an_error_ends_the_page():
    called = []

    def frame():
        called.append(time.monotonic())
        if len(called) == 3:
            time.sleep(0.5)  # ten frames
        if len(called) == 8:
            raise RuntimeError('broken')

    bare = page.Page.__new__(page.Page)
    bare._ended, bare._recent, bare.turns = threading.Event(), [], 0
    bare.session = SimpleNamespace(scene=SimpleNamespace(dt=0.05))
    bare.frame = frame
    with pytest.raises(RuntimeError, match='broken'):
        bare.run()
    assert called[7] - called[3] > 0.05  # two of four frames are made up for, not ten


def test_pictures_have_the_scale_of_their_legends():
    """The first and the last colour at the ends; grey where there is nothing."""
    low, high = drawing.HEIGHTS
    row = np.array([[low], [high], [np.nan]])
    picture = drawing.height_picture(row, -1.0, pixels=1)[0]
    assert picture.tolist() == [[drawing.EMPTY] * 3, *drawing.HEIGHT[[-1, 0]].tolist()]
    rest = np.zeros((2, 3))
    moved = rest + [[0.0, 0, 0], [0, drawing.MOVED, 0]]
    colours = drawing.soil_colours(moved, rest, np.ones((2, 1)))
    assert colours.tolist() == drawing.SOIL[[0, -1]].tolist()
    for word in ('-80<', '50<', 'rgb(70 42 20)', 'rgb(245 225 130)'):
        assert word in drawing.LEGENDS
    said = drawing.lamp(session_of('excavation_v2'), 60.0)
    assert 'within the training runs' in said and 'torque' not in said
    live = session_of('excavation_v2').advance()
    said = drawing.lamp(session_of('excavation_v2'), 60.0)
    assert f'&plusmn; {live.bound:.0f} N' in said and f'torque {live.torque[2]:.2f} N m' in said


def test_bad_input_is_refused_at_the_door(monkeypatch):
    done = subprocess.run(
        [sys.executable, '-m', 'learning_to_simulate.live_page', '--model=plough'],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 1 and done.stderr.startswith('error: plough: no folder with')
    with socket.create_server(('localhost', 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ValueError, match=f'port {port} of localhost cannot be listened at'):
            command.check_door('localhost', port)
    names = command.model_names()
    assert {'excavation_v2/swept_field', 'wheel/pcg'} < set(names) <= set(lts.list())
    monkeypatch.setattr(command.importlib.util, 'find_spec', lambda name: None)
    with pytest.raises(ValueError, match=r'viser is not installed: pip install .*\[live\]'):
        command.check_door('localhost', 0)


@pytest.fixture
def tab():
    api = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    if CHROMIUM is None:
        pytest.skip('no chromium here: apt install chromium')
    with api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=BROWSER)
        made = opened.new_page(viewport={'width': 1000, 'height': 760})
        made.set_default_timeout(120e3)
        yield made
        opened.close()


def test_in_a_browser_sliders_keys_handle_and_reset(shown, tab, tmp_path):
    session, image = shown.session, pytest.importorskip('PIL.Image')

    def wait(condition):
        for _ in range(480):
            if condition():
                return
            tab.wait_for_timeout(250)
        raise AssertionError('the page did not get there')

    def picture(name):
        """The scene, as it is on the screen."""
        tab.screenshot(path=str(tmp_path / name))
        return np.asarray(image.open(tmp_path / name).convert('RGB'), float)[:, :660]

    tab.goto(f'http://localhost:{shown.server.get_port()}')
    reset = tab.get_by_role('button', name='Reset', exact=True)
    reset.wait_for()
    wait(lambda: session.moment.frame > 10)
    shown.pause()
    before = picture('before.png')
    assert before.std() > 10  # soil and blade are drawn
    shown.pause()
    # A slider by the arrow keys, others by the keys of the page.
    deeper, speed = (session.steering.sliders[name] for name in ('depth', 'speed'))
    at = deeper.value
    tab.get_by_role('slider').first.focus()
    for _ in range(3):
        tab.keyboard.press('ArrowRight')
    wait(lambda: deeper.value > at + 0.5)
    tab.evaluate('document.activeElement.blur()')
    for key, enough in (('u', lambda: deeper.value > 5.0), ('i', lambda: speed.value > 15.0)):
        for _ in range(9):
            tab.keyboard.press(key)
        wait(enough)
    start = session.path()[0, 0]
    wait(lambda: (session.plane[0] - start) * session.forwards > 0.06)
    shown.pause()
    tab.wait_for_timeout(2000)
    assert np.abs(picture('after.png') - before).max(axis=2).mean() > 1.0  # the blade has moved
    shown.pause()
    reset.click()
    wait(lambda: session.steering.sliders['speed'].value == 0.0)
    at = session.plane
    drag(shown, tab)
    wait(lambda: not shown._dragging)
    assert not np.allclose(session.plane[:2], at[:2], atol=1e-4)


def drag(shown, tab):
    """Pulls at the handle until it has been caught, at places around the middle of the blade."""
    for dx, dy in ((0, 0), (20, 0), (0, -25), (25, -25), (-20, 10), (40, -10), (10, 15), (0, -45)):
        (one,) = shown.server.get_clients().values()
        turn = viser.transforms.SO3(np.asarray(one.camera.wxyz)).as_matrix()
        seen = turn.T @ (shown._handle.position - one.camera.position)
        box = tab.locator('canvas').first.bounding_box()
        focal = 0.5 * box['height'] / np.tan(0.5 * one.camera.fov)
        x = box['x'] + box['width'] / 2 + focal * seen[0] / seen[2] + dx
        y = box['y'] + box['height'] / 2 + focal * seen[1] / seen[2] + dy
        tab.mouse.move(x, y)
        tab.wait_for_timeout(600)
        tab.mouse.down()
        tab.wait_for_timeout(300)
        tab.mouse.move(x - 40, y + 30, steps=4)
        tab.wait_for_timeout(600)
        caught = shown._dragging
        tab.mouse.up()
        if caught:
            return
    raise AssertionError('the handle could not be caught')
