"""The page: on the wire with the extra `live`, and in a real browser where one is there."""

import shutil
import socket
import subprocess
import sys
import threading

import numpy as np
import pytest

from tests.learning_to_simulate.live_page import sessions

viser = pytest.importorskip('viser', reason='the extra `live` is not installed')

from learning_to_simulate.live_page import client, loop, page  # noqa: E402
from learning_to_simulate.live_page.__main__ import free_port as check_port  # noqa: E402
from learning_to_simulate.live_page.__main__ import model_names  # noqa: E402

PATIENCE = 120.0  # s; a browser without a graphics card on a busy machine is slow
CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser')
# WebGL without a graphics card.
BROWSER = (
    '--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader',
)  # fmt: skip


def free_port():
    with socket.create_server(('localhost', 0)) as server:
        return server.getsockname()[1]


class Running:
    """A page with its loop and the port that it listens at."""

    def __init__(self, name='excavation'):
        self.port = free_port()
        self.page = page.Page(
            sessions.make, ['excavation', 'wheel', 'nothing'], name, port=self.port
        )
        self.loop = loop.FrameLoop(self.page.frame, self.page.session.scene.dt)
        self.loop.start()

    def stop(self):
        self.loop.stop()
        self.page.stop()
        self.loop.wait()


@pytest.fixture
def running():
    shown = Running()
    yield shown
    shown.stop()


def test_a_slider_and_the_handle_move_the_tool_and_all_tabs_see_it(running):
    first, second = client.Client(running.port), client.Client(running.port)
    first.wait(lambda: first.frames > 5 and second.frames > 5, PATIENCE)
    session = running.page.session
    first.slide('depth, mm', 20.0)
    second.wait(lambda: session.steering.sliders['depth'].value == 20.0, PATIENCE)
    start = session.plane
    place = session.moment.pose[:3] + [0.05 * session.forwards, -0.02, 0.0]
    second.drag(place)
    first.wait(lambda: np.allclose(session.plane[:2], place[:2], atol=1e-6), PATIENCE)
    assert not np.allclose(start[:2], place[:2]) and session.moment.force.any()
    first.close()
    second.close()


def test_closed_tabs_and_slow_ones_lose_nothing(running):
    slow, quick = client.Client(running.port, reads=False), client.Client(running.port)
    session = running.page.session
    quick.wait(lambda: quick.frames > 30, PATIENCE)
    quick.drag(session.moment.pose[:3] + [0.02 * session.forwards, 0.0, 0.0])
    quick.close()  # in the middle of a drag
    slow.wait(lambda: not running.page._dragging, PATIENCE)
    at = session.moment.frame
    slow.wait(lambda: session.moment.frame > at + 10, PATIENCE)  # the slow one holds up nobody
    slow.close()
    slow.wait(lambda: not running.page.server.get_clients(), PATIENCE)
    slow.wait(lambda: running.loop.frames > 0, PATIENCE)
    kept = session.moment.frame  # without a browser the soil waits ...
    frames = running.loop.frames
    slow.wait(lambda: running.loop.frames > frames + 5, PATIENCE)
    assert session.moment.frame <= kept + 1
    again = client.Client(running.port)
    again.wait(lambda: session.moment.frame > kept + 5, PATIENCE)  # ... and goes on
    assert len(session.path()) == session.moment.frame + 1
    again.close()


def test_another_model_and_one_that_is_not_there(running):
    tab = client.Client(running.port)
    tab.wait(lambda: tab.frames > 2, PATIENCE)
    tab.slide('scene / model', 'nothing')
    tab.wait(lambda: running.page.panel.model.value == 'excavation', PATIENCE)
    tab.slide('scene / model', 'wheel')
    tab.wait(lambda: running.page.session.scene.name == 'wheel', PATIENCE)
    tab.wait(lambda: 'slip, %' in tab.gui and running.page.session.moment.frame > 5, PATIENCE)
    assert abs(running.page.session.plane[2]) > 0.01  # it has turned, its arrow has not
    assert tuple(running.page._handle.wxyz) == (1.0, 0.0, 0.0, 0.0)
    lightest = float(running.page.session.model.starts.context[:, 2].min())
    tab.slide('load (restarts)', lightest)
    tab.wait(lambda: running.page.session.context['load'] == pytest.approx(lightest), PATIENCE)
    tab.slide('path', next(iter(running.page.session.recorded.runs)))
    tab.wait(lambda: running.page.session.run is not None, PATIENCE)
    tab.slide('slip, %', 30.0)  # whoever touches the tool takes it over
    tab.wait(lambda: running.page.panel.run.value == page.BY_HAND, PATIENCE)
    assert running.page.session.run is None
    tab.close()


def test_a_frame_that_fails_ends_the_loop_with_its_error():
    def frame():
        raise RuntimeError('broken')

    turning = loop.FrameLoop(frame, 1 / 60)
    turning.start()
    with pytest.raises(RuntimeError, match='broken'):
        turning.wait()
    turning.stop()


def test_the_loop_keeps_its_rate_and_does_not_bunch_lost_frames():
    called, hold = [], threading.Event()

    def frame():
        called.append(None)
        if len(called) == 3:
            hold.wait(0.5)

    turning = loop.FrameLoop(frame, 0.05)
    turning.start()
    for _ in range(200):
        if len(called) >= 6:
            break
        hold.wait(0.02)
    turning.stop()
    # The half second that was lost holds ten frames; they do not come at once.
    assert 6 <= len(called) < 12 and turning.frames == len(called)


def test_bad_input_is_refused_at_the_door():
    def start(*arguments):
        return subprocess.run(
            [sys.executable, '-m', 'learning_to_simulate.live_page', *arguments],
            capture_output=True, text=True,
        )  # fmt: skip

    unknown = start('--model=plough')
    assert unknown.returncode == 1 and unknown.stderr.startswith('error: plough: no folder with')
    with socket.create_server(('localhost', 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ValueError, match=f'port {port} of localhost cannot be listened at'):
            check_port('localhost', port)
        occupied = start(f'--port={port}')
    assert occupied.returncode == 1 and occupied.stderr.startswith(f'error: port {port} of')


def test_models_that_can_be_chosen_are_those_that_step():
    names = model_names()
    assert 'excavation/pcg' in names and 'wheel/pcg' in names


@pytest.fixture
def browser():
    api = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    if CHROMIUM is None:
        pytest.skip('no chromium here: apt install chromium')
    with api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=BROWSER)
        tab = opened.new_page(viewport={'width': 1000, 'height': 760})
        tab.set_default_timeout(1e3 * PATIENCE)
        yield tab
        opened.close()


def picture(tab, path):
    """float [H, W, 3] of the scene, as it is on the screen."""
    image = pytest.importorskip('PIL.Image')
    tab.screenshot(path=str(path))
    return np.asarray(image.open(path).convert('RGB'), float)[:, :660]


def test_in_a_browser_sliders_keys_handle_and_reset(running, browser, tmp_path):
    session, tab = running.page.session, browser

    def wait(condition):
        for _ in range(int(PATIENCE / 0.25)):
            if condition():
                return
            tab.wait_for_timeout(250)
        raise AssertionError('the page did not get there')

    tab.goto(f'http://localhost:{running.port}')
    reset = tab.get_by_role('button', name='Reset', exact=True)
    reset.wait_for()
    wait(lambda: session.moment.frame > 10)
    running.page.pause()
    before = picture(tab, tmp_path / 'before.png')
    assert before.std() > 10  # soil and blade are drawn
    # A slider by the arrow keys, another by the keys of the page.
    running.page.pause()
    deeper = session.steering.sliders['depth']
    at = deeper.value
    tab.get_by_role('slider').first.focus()
    for _ in range(3):
        tab.keyboard.press('ArrowRight')
    wait(lambda: deeper.value > at + 0.5)
    tab.evaluate('document.activeElement.blur()')
    for _ in range(9):
        tab.keyboard.press('u')
    wait(lambda: deeper.value > 5.0)
    for _ in range(9):
        tab.keyboard.press('i')
    wait(lambda: session.steering.sliders['speed'].value > 15.0)
    start = session.path()[0, 0]
    wait(lambda: (session.plane[0] - start) * session.forwards > 0.06)
    running.page.pause()
    tab.wait_for_timeout(2000)
    after = picture(tab, tmp_path / 'after.png')
    assert np.abs(after - before).max(axis=2).mean() > 1.0  # the blade has moved
    running.page.pause()
    reset.click()
    wait(lambda: session.steering.sliders['speed'].value == 0.0)
    # The arrow of the handle that points along the drive: where it is on the screen, from a sweep.
    at = session.plane
    drag(tab, running, wait)
    assert not np.allclose(session.plane[:2], at[:2], atol=1e-4)


def drag(tab, running, wait):
    """Pulls at the handle until it has been caught: places around the middle of the blade."""
    for dx, dy in ((0, 0), (20, 0), (0, -25), (25, -25), (-20, 10), (40, -10), (10, 15), (0, -45)):
        x, y = handle_on_screen(tab, running)
        tab.mouse.move(x + dx, y + dy)
        tab.wait_for_timeout(600)
        tab.mouse.down()
        tab.wait_for_timeout(300)
        tab.mouse.move(x + dx - 40, y + dy + 30, steps=4)
        tab.wait_for_timeout(600)
        caught = running.page._dragging
        tab.mouse.up()
        if caught:
            wait(lambda: not running.page._dragging)
            return
    raise AssertionError('the handle could not be caught')


def handle_on_screen(tab, running):
    """Pixel of the handle, through the camera of the tab."""
    (one,) = running.page.server.get_clients().values()
    camera = one.camera
    turn = viser.transforms.SO3(np.asarray(camera.wxyz)).as_matrix()
    seen = turn.T @ (running.page._handle.position - camera.position)
    box = tab.locator('canvas').first.bounding_box()
    focal = 0.5 * box['height'] / np.tan(0.5 * camera.fov)
    return (
        box['x'] + box['width'] / 2 + focal * seen[0] / seen[2],
        box['y'] + box['height'] / 2 + focal * seen[1] / seen[2],
    )
