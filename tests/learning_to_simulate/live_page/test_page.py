"""The page: on the wire with the extra `live`, and in a real browser where one is there."""

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
from tests.learning_to_simulate.live_page.client import Client  # noqa: E402

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


@pytest.fixture
def shown():
    """A page of the blade whose frames are computed by a thread; its port."""
    with socket.create_server(('localhost', 0)) as server:
        port = server.getsockname()[1]
    made = page.Page(load, ['excavation', 'wheel', 'nothing'], 'excavation', port=port)
    made.port, thread = port, threading.Thread(target=made.run, daemon=True)
    thread.start()
    yield made
    made.stop()
    thread.join()


def test_a_slider_and_the_handle_move_the_tool_and_all_tabs_see_it(shown):
    first, second = Client(shown.port), Client(shown.port)
    first.wait(lambda: first.frames > 5 and second.frames > 5)
    session = shown.session
    first.slide('depth, mm', 20.0)
    second.wait(lambda: session.steering.sliders['depth'].value == 20.0)
    start = session.plane
    place = session.moment.pose[:3] + [0.05 * session.forwards, -0.02, 0.0]
    second.drag(place)
    first.wait(lambda: np.allclose(session.plane[:2], place[:2], atol=1e-6))
    assert not np.allclose(start[:2], place[:2]) and session.moment.force.any()
    first.wait(lambda: any('force' in text and ' up' in text for text in first.texts))
    assert any('way that soil has moved' in text and '80<' in text for text in first.texts)
    first.close()
    second.close()


def test_slow_tabs_hold_up_nobody_and_without_a_browser_the_tool_stands(shown):
    slow, quick = Client(shown.port, reads=False), Client(shown.port)
    session = shown.session
    quick.wait(lambda: quick.frames > 30)
    quick.slide('speed, mm/s', 50.0)
    quick.drag(session.moment.pose[:3] + [0.02 * session.forwards, 0.0, 0.0])
    quick.close()  # in the middle of a drag
    slow.wait(lambda: not shown._dragging)
    at = session.moment.frame
    slow.wait(lambda: session.moment.frame > at + 10)
    slow.close()
    slow.wait(lambda: not shown.server.get_clients())
    turns = shown.turns
    slow.wait(lambda: shown.turns > turns + 5)
    kept = session.moment.frame
    again = Client(shown.port)
    turns = shown.turns
    again.wait(lambda: shown.turns > turns + 5)
    assert session.moment.frame == kept and 'paused' in shown.panel._said
    shown.do(shown.pause)
    again.wait(lambda: session.moment.frame > kept + 5)
    assert len(session.path()) == session.moment.frame + 1
    again.close()


def test_another_model_and_one_that_is_not_there(shown):
    tab = Client(shown.port)
    tab.wait(lambda: tab.frames > 2)
    tab.slide('scene / model', 'nothing')
    tab.wait(lambda: shown.panel.model.value == 'excavation')
    tab.slide('scene / model', 'wheel')
    tab.wait(lambda: shown.session.scene.name == 'wheel')
    tab.wait(lambda: 'slip, %' in tab.gui and shown.session.moment.frame > 5)
    assert abs(shown.session.plane[2]) > 0.01  # it has turned, its arrow has not
    assert tuple(shown._handle.wxyz) == (1.0, 0.0, 0.0, 0.0)
    lightest = float(shown.session.model.starts.context[:, 2].min())
    tab.slide('load (restarts)', lightest)
    tab.wait(lambda: shown.session.context['load'] == pytest.approx(lightest))
    tab.slide('path', next(iter(shown.session.recorded.runs)))
    tab.wait(lambda: shown.session.run is not None)
    tab.slide('slip, %', 30.0)  # whoever touches the tool takes it over
    tab.wait(lambda: shown.panel.run.value == gui.BY_HAND)
    assert shown.session.run is None
    tab.close()


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

    tab.goto(f'http://localhost:{shown.port}')
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
