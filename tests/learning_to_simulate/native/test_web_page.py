"""The page without a server: its WebAssembly against the stepper, and the page in a browser."""

import json
import pathlib
import re
import shutil
import subprocess

import numpy as np
import pytest

import learning_to_simulate as lts
from learning_to_simulate.live_page.session import Session
from learning_to_simulate.native import agreement, project, web_page
from pca_tools import files

ROOT = pathlib.Path(__file__).resolve().parents[3]
SHOWN = 'docs/live/excavation.html'
needs_compiler = pytest.mark.skipif(
    not web_page.is_available(), reason=f'needs {web_page.MISSING}'
)
# Poses in, one a line; forces and the last particle out.
DRIVER = """
const fs = require('fs');
const poses = JSON.parse(fs.readFileSync(0, 'utf8'));
WebAssembly.instantiate(fs.readFileSync(process.argv[1]), {}).then(({ instance }) => {
  const soil = instance.exports, memory = soil.memory.buffer;
  const status = [soil.page_start()], out = [];
  for (const p of poses) {
    new Float64Array(memory, soil.page_pose(), 7).set(p);
    status.push(soil.page_frame());
    out.push([...new Float64Array(memory, soil.page_force(), 3),
      ...new Float32Array(memory, soil.page_particles(), 3)]);
  }
  console.log(JSON.stringify({ status, out, imports: WebAssembly.Module.imports(
    new WebAssembly.Module(fs.readFileSync(process.argv[1]))) }));
});
"""


@needs_compiler
@pytest.mark.skipif(not shutil.which('node'), reason='no node')
def test_webassembly_gives_the_frames_of_the_stepper(tmp_path):
    values = agreement.Opened.of('models/excavation/pcg').values()
    (tmp_path / 'soil.wasm').write_bytes(
        web_page.compile_model(project.symbol('models/excavation/pcg'), values)
    )
    model = lts.load('excavation')
    live, pose = model.stepper(), model.starts.pose[0]
    middle = model.starts.body[0][model.starts.kept[0]].mean(axis=0)  # the library's reference
    path = [pose + [-8e-4 * k, -8e-4 * k, 0, 0, 0, 0, 0] for k in range(1, 41)]
    path.append(pose * np.nan)
    sent = [[*(p[:3] + middle), *p[3:]] for p in path]
    done = subprocess.run(
        ['node', '-e', DRIVER, str(tmp_path / 'soil.wasm')],
        input=json.dumps(np.nan_to_num(sent, nan=1e300).tolist()),
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    answer = json.loads(done.stdout)
    assert answer['imports'] == []  # it can call nothing outside of itself
    assert answer['status'][:-1] == [0] * 41 and answer['status'][-1] < 0
    live.start()
    frames = [live.step(p) for p in path[:-1]]
    out = np.array(answer['out'][:-1])
    force = np.array([frame.force for frame in frames])
    np.testing.assert_allclose(out[:, :3], force, atol=1e-4 * np.abs(force).max())
    first = np.array([frame.particles()[0] for frame in frames])
    np.testing.assert_allclose(out[:, 3:], first, atol=1e-5)


@pytest.mark.skipif(not (ROOT / SHOWN).exists(), reason='not in this copy')
def test_the_page_of_the_documents_is_of_the_shipped_model():
    text = (ROOT / SHOWN).read_text(encoding='utf-8')
    digest = re.search(r'digest ([0-9a-f]{12})\.', text)
    assert digest[1] == files.sha256_of_file('models/excavation/pcg/weights.npz')[:12], (
        f'{SHOWN} is of another model; again: lts export --format=page '
        f'--model_path=models/excavation/pcg --data_path=datasets/excavation --output_path={SHOWN}'
    )


def test_what_a_page_needs_is_named(monkeypatch):
    monkeypatch.setattr(web_page, 'is_available', lambda: False)
    with pytest.raises(ValueError, match='no compiler for WebAssembly.*pip install ziglang'):
        web_page.compile_model('lts_small', {'n_soil': 3})
    monkeypatch.setattr(web_page, 'is_available', lambda: True)
    with pytest.raises(ValueError, match='no subspace'):
        web_page.compile_model('lts_small', {'n_soil': 0})


@pytest.mark.skipif(not (ROOT / SHOWN).exists(), reason='not in this copy')
def test_the_page_digs_in_a_browser(tmp_path):
    api = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    chromium = shutil.which('chromium') or shutil.which('chromium-browser')
    if chromium is None:
        pytest.skip('no chromium here: apt install chromium')
    arguments = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader',
                 '--enable-unsafe-swiftshader']  # fmt: skip
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=arguments)
        tab = browser.new_page(viewport={'width': 900, 'height': 520})
        tab.set_default_timeout(120_000)
        tab.goto((ROOT / SHOWN).as_uri())
        tab.wait_for_function('window.soil && window.soil.state().frame > 2')
        first = tab.evaluate('window.soil.state()')
        sliders = tab.locator('input[type=range]')
        sliders.nth(0).fill('20')  # depth
        sliders.nth(1).fill('100')  # speed
        tab.wait_for_function(f'window.soil.state().frame > {first["frame"]} + 90')
        tab.click('#pause')
        now = tab.evaluate('window.soil.state()')
        tab.screenshot(path=str(tmp_path / 'page.png'))
        assert now['broken'] == '' and now['outside'] == '' and now['plane'] != first['plane']
        assert np.linalg.norm(now['force']) > 10.0
        tab.click('#pause')
        tab.click('#reset')
        tab.wait_for_function(f'window.soil.state().frame < {now["frame"]}')
        browser.close()


def test_settings_are_those_of_the_live_page():
    session = Session(lts.load('wheel'))
    said = web_page.settings(session)
    assert said['driven'] and said['low'] < said['start'][0] < said['high']
    assert [s['name'] for s in said['sliders']] == list(session.steering.sliders)
    assert len(said['faces']) >= 12 and np.shape(said['plan']) == (len(session.body()), 2)
