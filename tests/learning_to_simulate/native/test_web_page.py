"""The page without a server, in a browser: its frames against the stepper, its controls."""

import contextlib
import csv
import io
import json
import pathlib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from learning_to_simulate.native import soil_data, web_page
from learning_to_simulate.soil_field.field import WORDS
from learning_to_simulate.soil_field.loaded import LoadedTool
from learning_to_simulate.soil_field.stepper import SoilStepper
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Blade, Wheel
from reports import page as page_report
from tests.learning_to_simulate.native import worlds
from tests.learning_to_simulate.soil_field import worlds as soil_worlds

PRESETS = {
    'blade': ('Slice', 'Trench', 'Cut beside', 'Press and hold'),
    'wheel': ('Drive under load', 'Spin with slip'),
}
# Steps without drawing; what they were.
STEPS = """(count) => {
  const seen = [], m = page.machine;
  for (let k = 0; k < count; k++) {
    page.advance(1 / 60);
    seen.push([...m.pose, ...m.force, ...m.torque, m.code]);
  }
  m.c.page_update();
  return { seen, heights: [...m.heights()] };
}"""


FIELDS = {
    'blade': lambda: soil_worlds.trained()[0],
    'wheel': lambda: worlds.soil_field('wheel'),
}


def terrain_of(ground):
    """The terrain of `page.flat()`."""
    size = tuple(np.multiply(ground['cell'], ground['n']))
    made = Terrain.flat(
        size, cell=tuple(ground['cell']), corner=tuple(ground['corner']), floor=ground['floor']
    )
    assert made.shape == tuple(ground['n'])
    return made


@pytest.fixture(scope='module')
def pages(tmp_path_factory):
    """Paths of the pages of small fields; that of the blade has a recorded run."""
    if not web_page.is_available():
        pytest.skip(f'needs {web_page.MISSING}')
    folder, flags = tmp_path_factory.mktemp('pages'), list(web_page.TARGET)
    flags[flags.index('-O3')] = '-O1'  # compiled in half of the time
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(web_page, 'TARGET', flags)
        for kind in PRESETS:
            run = soil_worlds.run(3) if kind == 'blade' else None
            web_page.write(str(folder / f'{kind}.html'), f'lts_small_{kind}', FIELDS[kind](), run)
    return folder


@pytest.fixture(scope='module')
def browser():
    with contextlib.ExitStack() as stack:
        try:
            found = stack.enter_context(page_report.browser())
        except ValueError as error:
            pytest.skip(str(error))
        yield found


@contextlib.contextmanager
def opened(browser, path, complaint='', **options):
    """A tab with a page that has started and waits; it must neither complain nor load anything."""
    said, asked = [], []
    tab = browser.new_page(viewport={'width': 500, 'height': 640}, **options)
    tab.set_default_timeout(120_000)
    tab.on('console', lambda message: said.append(message.text))
    tab.on('pageerror', lambda error: said.append(str(error)))
    tab.on('request', lambda request: asked.append(request.url))
    tab.goto(path.as_uri())
    tab.wait_for_function('window.page && page.frame > 1')
    tab.evaluate('page.pause(true)')
    yield tab
    tab.close()
    assert [text for text in said if not complaint or complaint not in text] == []
    assert asked == [path.as_uri()] and (not complaint or said)


def told(tab, code, *given):
    """What a function of the page returns, as one text: a long list takes the browser seconds."""
    return json.loads(tab.evaluate(f'(x) => JSON.stringify(({code})(x))', *given))


@pytest.mark.parametrize('kind', PRESETS)
def test_presets_give_the_frames_of_the_stepper(browser, pages, kind):
    with opened(browser, pages / f'{kind}.html') as tab:
        imports = 'WebAssembly.Module.imports(new WebAssembly.Module(b))'
        # It can call nothing outside of itself.
        assert tab.evaluate(f'unpacked(packed).then((b) => {imports})') == []
        for name in PRESETS[kind]:
            tab.get_by_role('button', name=name, exact=True).click()
            tab.evaluate('page.pause(true)')
            tab.get_by_role('button', name='Reset').click()
            assert tab.evaluate('page.frame') == 0
            if kind == 'wheel':  # networks without training bear no load
                tab.locator('#loaded').uncheck()
                tab.evaluate('page.driver.target.depth = 0.02')
            first = tab.evaluate('[...page.machine.pose]')
            ground, tool = tab.evaluate('[page.flat(), page.machine.tool]')
            answer = told(tab, STEPS, 200)
            seen = np.array(answer['seen'])
            assert (seen[:, -1] >= 0).all(), name
            made = Wheel(*tool[:2], *tool[7:]) if kind == 'wheel' else Blade(*tool[:7])
            terrain = terrain_of(ground)
            live = SoilStepper(FIELDS[kind](), terrain, made)
            live.start(first)
            frames = [live.step(pose) for pose in seen[:, :7]]
            for part, at in (('force', 7), ('torque', 10)):
                wanted = np.array([getattr(frame, part) for frame in frames])
                assert np.abs(wanted).max() > 0
                np.testing.assert_allclose(
                    seen[:, at : at + 3], wanted, atol=2e-5 * np.abs(wanted).max(), err_msg=name
                )
            heights = np.reshape(answer['heights'], terrain.shape)
            np.testing.assert_allclose(heights, terrain.heights, atol=1e-6, err_msg=name)


def test_a_load_is_borne_as_by_a_loaded_tool(browser, pages):
    with opened(browser, pages / 'blade.html') as tab:
        tab.evaluate("page.play('Press and hold'); page.pause(true); page.script = null")
        first = tab.evaluate('[...page.machine.pose]')
        ground, tool = tab.evaluate('[page.flat(), page.machine.tool]')
        tab.locator('#loaded').check()
        tab.evaluate('page.driver.target.load = 60; page.driver.target.speed = 0.05')
        seen = np.array(told(tab, STEPS, 60)['seen'])
    assert (seen[:, -1] >= 0).all()
    live = SoilStepper(FIELDS['blade'](), terrain_of(ground), Blade(*tool[:7]))
    live.start(first)
    loaded = LoadedTool(live, mass=60 / live.terrain.soil.gravity)
    heights = [loaded.step(pose).pose[1] for pose in seen[:, :7]]
    np.testing.assert_allclose(seen[:, 1], heights, atol=1e-5)
    assert seen[-1, 8] > 30  # N, up: it does not fall any more


def test_a_recorded_run_is_played_beside(browser, pages):
    run = soil_worlds.run(3)
    with opened(browser, pages / 'blade.html') as tab:
        tab.get_by_role('button', name='Beside the solver').click()
        tab.evaluate('page.pause(true); page.reset()')
        told(tab, STEPS, len(run.pose) + 5)
        tab.evaluate('page.draw()')
        rows, maps, status = told(
            tab, '() => [page.rows, config.ghost.maps.map((m) => [...m]), page.machine.reason()]'
        )
        tab.evaluate('page.show()')
        assert 'over' in tab.inner_text('#status') or status
        # The axis of forces holds the band of the bound, which is none beyond training.
        some = [
            {'t': 0, 'force': [50, 10, 0], 'bound': 120, 'ghost': None},
            {'t': 1, 'force': [60, 10, 0], 'bound': None, 'ghost': [0, 310, 0]},
        ]
        code = '(rows) => plotRange(rows.map((r) => ({...r, bound: r.bound ?? Infinity})))'
        assert tab.evaluate(code, some) == [-200, 400, 200]
        assert tab.evaluate(code, some[:1]) == [-200, 200, 100]
    ghost = np.array([row['ghost'] for row in rows])
    np.testing.assert_allclose(ghost[:, 1], run.force[1:, 1][-len(ghost) :], atol=0.01)
    np.testing.assert_allclose(ghost[:, 0], run.force[1:, 0][-len(ghost) :], atol=0.01)
    np.testing.assert_allclose(np.reshape(maps, run.heights.shape), run.heights, atol=1e-4)


def test_steering_recording_and_what_is_refused(browser, pages):
    with opened(browser, pages / 'blade.html') as tab:
        tab.evaluate('page.reset(); page.script = null')
        tab.keyboard.down('w')
        tab.keyboard.down('f')
        tab.evaluate('page.held(); page.held()')
        assert tab.evaluate('page.driver.target.speed') > 0
        tab.keyboard.up('w')
        tab.keyboard.up('f')
        box = tab.locator('#pad').bounding_box()
        tab.mouse.move(box['x'] + box['width'] / 2, box['y'] + 5)
        tab.mouse.down()
        pushed = tab.evaluate('page.pushed')
        assert pushed[1] > 0.8
        tab.mouse.up()
        assert tab.evaluate('[page.pushed, page.driver.target.speed]') == [None, 0]
        tab.get_by_role('button', name='Record').click()
        tab.evaluate('page.driver.target.depth = 0.02; page.driver.target.speed = 0.1')
        seen = np.array(told(tab, STEPS, 60)['seen'])
        tab.get_by_role('button', name='Stop').click()
        rows = list(csv.DictReader(io.StringIO(tab.evaluate('page.csv()'))))
        assert len(rows) == 60 and tab.locator('#download').is_enabled()
        kept = [[float(row[f'f{i}_N']) for i in 'xyz'] for row in rows]
        np.testing.assert_allclose(kept, seen[:, 7:10])
        with tab.expect_download() as download:
            tab.get_by_role('button', name='Download CSV').click()
        assert download.value.suggested_filename == 'blade.csv'
        written = pathlib.Path(download.value.path()).read_text(encoding='utf-8')
        assert written == tab.evaluate('page.csv()')
        before = tab.evaluate('[...page.machine.pose]')
        tab.evaluate('page.driver.state.x = NaN; page.advance(1 / 60); page.show()')
        assert 'Held back' in tab.inner_text('#status')
        assert tab.evaluate('[...page.machine.pose]') == before
        tab.evaluate('page.reset(); page.show()')
        assert 'Held back' not in tab.inner_text('#status')
        assert tab.evaluate('page.grains, page.machine.grains().count') >= 0
        times = tab.evaluate('page.frameTimes()')
        assert 0 < times['median'] <= times['high']


def test_fingers_drive_the_tool_and_pinch_the_view(browser, pages):
    with opened(browser, pages / 'blade.html', has_touch=True) as tab:
        tab.evaluate('page.reset(); page.script = null')
        device = tab.context.new_cdp_session(tab)

        def touch(kind, *places):
            points = [{'x': x, 'y': y, 'id': k} for k, (x, y) in enumerate(places)]
            device.send('Input.dispatchTouchEvent', {'type': kind, 'touchPoints': points})

        box = tab.locator('#pad').bounding_box()
        touch('touchStart', (box['x'] + box['width'] / 2, box['y'] + 5))
        tab.wait_for_function('page.pushed && page.pushed[1] > 0.8')
        tab.evaluate('page.held()')
        assert tab.evaluate('page.driver.target.speed') > 0
        touch('touchEnd')
        tab.wait_for_function('page.pushed === null && page.driver.target.speed === 0')
        before = tab.evaluate('page.scene.distance')
        touch('touchStart', (240, 150), (260, 150))
        touch('touchMove', (220, 150), (280, 150))
        tab.wait_for_function(f'page.scene.distance < {before / 2}')
        touch('touchEnd')


def test_the_status_says_in_words_what_is_unlike_training(browser, pages):
    with opened(browser, pages / 'blade.html') as tab:
        tab.evaluate('page.reset(); page.script = null; page.driver.target.depth = 0.2')
        told(tab, STEPS, 240)
        name = tab.evaluate('page.machine.reason()').split()[0]
        tab.evaluate('page.show()')
        words = WORDS[name][0]
        text = tab.inner_text('#status')
        assert text.startswith(f'Beyond what the model was trained on: {words},')
        assert f'({name}; trained: ' in text
        # Torque about the tool's own axis across, of a tool that has turned.
        torque, heading = np.array([3.0, 0.0, 5.0]), 0.3
        pose = [0, 0, 0, np.cos(heading / 2), 0, np.sin(heading / 2), 0]
        code = '([t, p]) => Object.getOwnPropertyDescriptor(Machine.prototype, "pitch")'
        found = tab.evaluate(f'{code}.get.call({{ torque: t, pose: p }})', [torque.tolist(), pose])
        across = Rotation.from_quat([*pose[4:], pose[3]]).apply([0.0, 0.0, 1.0])
        assert found == pytest.approx(torque @ across)


def test_an_error_in_a_frame_does_not_stop_the_page(browser, pages):
    with opened(browser, pages / 'blade.html', 'broken') as tab:
        told(tab, STEPS, 30)
        tab.evaluate("""() => {
          const draw = page.draw.bind(page);
          page.draw = () => { page.draw = draw; throw new Error('broken on purpose'); };
        }""")
        tab.wait_for_function("page.said.includes('laid out anew')")
        tab.evaluate('page.pause(false)')
        tab.wait_for_function('page.frame > 2')
        assert 'broken' not in tab.inner_text('#status')
        tab.evaluate("() => { page.draw = () => { throw new Error('broken for good'); }; }")
        tab.wait_for_function("page.trouble.includes('load it again')")
        assert 'load it again' in tab.inner_text('#status')


def test_a_graphics_card_that_was_away_draws_again(browser, pages):
    with opened(browser, pages / 'blade.html') as tab:
        tab.evaluate("""() => {
          window.card = page.scene.gl.getExtension('WEBGL_lose_context');
          card.loseContext();
        }""")
        tab.wait_for_function("page.said.includes('is away')")
        tab.evaluate('card.restoreContext()')
        tab.wait_for_function("page.said.includes('was away')")
        tab.evaluate('page.draw()')
        assert tab.evaluate('page.scene.gl.getError()') == 0
        pixels = """() => {
          const gl = page.scene.gl, seen = new Uint8Array(4);
          page.draw(); gl.readPixels(gl.drawingBufferWidth >> 1, gl.drawingBufferHeight >> 1, 1, 1,
            gl.RGBA, gl.UNSIGNED_BYTE, seen);
          return [...seen];
        }"""
        red, _, blue, _ = tab.evaluate(pixels)
        assert red > blue + 10  # soil, not paper


def test_every_number_that_is_judged_has_words():
    for kind in PRESETS:
        assert set(worlds.soil_field(kind).judged_names) <= set(WORDS)


def test_what_a_page_needs_is_named(monkeypatch, tmp_path):
    field = worlds.soil_field('blade')
    monkeypatch.setattr(web_page, 'is_available', lambda: False)
    with pytest.raises(ValueError, match='no compiler for WebAssembly.*pip install ziglang'):
        web_page.write(str(tmp_path / 'page'), 'lts_small', field)
    monkeypatch.setattr(web_page, 'compile_model', lambda name, values: b'')
    monkeypatch.setattr(web_page, 'MAX_BYTES', 1000)
    with pytest.raises(ValueError, match='more than 1000'):
        web_page.write(str(tmp_path / 'page'), 'lts_small', field)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not web_page.is_available(), reason=f'needs {web_page.MISSING}')
def test_c_that_does_not_compile_says_why(monkeypatch):
    monkeypatch.setattr(web_page, 'TARGET', ('--no-such-flag',))
    with pytest.raises(ValueError, match='ziglang cc --no-such-flag .* failed'):
        web_page.compile_model('lts_small', soil_data.values(worlds.soil_field('blade')))
