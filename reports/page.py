"""How fast the page without a server is: the pages of the shipped fields in headless Chromium.

Each page plays its first preset for ten seconds, with and without the grains that move along, while
the frames that the browser asks for are timed: median and 95 %. Then `COUNT` steps and drawings are
timed one by one until the graphics are done, lowest tenth and median: `step_ms` of the soil field,
`ground_ms` of its ground and grains in the frames that ask for them (`ground_share`), `draw_ms` of
the rest. Times hold for the renderer beside them; `--screenshots_path` keeps pictures.

Examples:
    python -m reports page --output_path=docs/page.json   # needs extras page and dev, Chromium
    python -m reports documents docs/native.md            # the table again, from the JSON
"""

import contextlib
import os
import pathlib
import shutil
import sys
import tempfile
from typing import Any

import numpy as np
from absl import flags

from pca_tools import files
from reports import markdown, record

MODELS = ('excavation', 'wheel')
SIZE = {'width': 1280, 'height': 720}  # of the window, pixels
PLAYED_S, COUNT = 10.0, 180
FRAMES = """(seconds) => new Promise((resolve) => {
  const times = [], look = (now) => {
    times.push(now);
    if (now - times[0] < 1000 * seconds) requestAnimationFrame(look); else resolve(times);
  };
  requestAnimationFrame(look);
})"""
# Milliseconds [count, 3] of the model's step, of its ground and grains (0: not asked for), and of
# all else, of a step and its drawing.
PARTS = """(count) => {
  const m = page.machine, gl = page.scene.gl, pixel = new Uint8Array(4), rows = [];
  const parts = { step: 0, changed: 1, grains: 1 };
  let row;
  for (const name in parts) {
    const inner = m[name].bind(m);
    m[name] = (...given) => {
      const start = performance.now(), answer = inner(...given);
      row[parts[name]] += performance.now() - start;
      return answer;
    };
  }
  for (let k = 0; k < count; k++) {
    const start = performance.now();
    row = [0, 0, 0];
    page.advance(1 / 60); page.draw();
    if (k % 9 === 0) page.show();  // as often as 60 frames a second show it
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);  // waits for the graphics
    row[2] = performance.now() - start - row[0] - row[1];
    rows.push(row);
  }
  for (const name in parts) delete m[name];
  return rows;
}"""
RENDERER = """() => {
  const gl = page.scene.gl, more = gl.getExtension('WEBGL_debug_renderer_info');
  return gl.getParameter(more ? more.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
}"""


@contextlib.contextmanager
def browser():
    """Headless Chromium that draws by the processor where there is no graphics card; ValueError:
    it, or playwright, is not installed."""
    try:
        from playwright import sync_api
    except ImportError as error:
        raise ValueError('pip install playwright, or learning_to_simulate_soil[dev]') from error
    chromium = shutil.which('chromium') or shutil.which('chromium-browser')
    if chromium is None:
        raise ValueError('there is no chromium here: apt install chromium')
    arguments = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader',
                 '--enable-unsafe-swiftshader']  # fmt: skip
    with sync_api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=chromium, args=arguments)
        yield found
        found.close()


def measured(found, path: pathlib.Path, screenshots: str | None) -> dict:
    """Of a page in a browser: bytes, s to the first picture, renderer, and times in ms without and
    with grains."""
    tab = found.new_page(viewport=SIZE)
    tab.set_default_timeout(120_000)
    tab.goto(path.as_uri())
    first = tab.wait_for_function('window.page && page.frame > 0 && performance.now()')
    row: dict = {'bytes': path.stat().st_size, 'first_picture_s': first.json_value() / 1e3,
                 'renderer': tab.evaluate(RENDERER)}  # fmt: skip
    for name in ('without grains', 'with grains'):
        tab.locator('#particles').set_checked(name == 'with grains')
        tab.evaluate('page.play(page.preset)')
        frames = np.diff(tab.evaluate(FRAMES, PLAYED_S))
        if screenshots:
            tab.screenshot(
                path=os.path.join(screenshots, f'{path.stem}_{name.replace(" ", "_")}.png')
            )
        tab.evaluate('page.play(page.preset); page.pause(true)')
        tab.evaluate('for (let k = 0; k < 120; k++) page.advance(1 / 60)')  # to where it digs
        parts = np.array(tab.evaluate(PARTS, COUNT))
        asked = parts[:, 1] > 0
        row[name] = {
            'frames': len(frames), 'frame_ms': _spread(frames, (0.5, 0.95)),
            'step_ms': _spread(parts[:, 0]), 'ground_ms': _spread(parts[asked, 1]),
            'ground_share': float(asked.mean()), 'draw_ms': _spread(parts[:, 2]),
            'pixels': tab.evaluate('page.scene.canvas.width * page.scene.canvas.height'),
        }  # fmt: skip
    tab.close()
    return row


def _spread(times, shares=(0.1, 0.5)) -> list[float]:
    return [float(value) for value in np.quantile(times, shares)]


def table(path: str) -> str:
    """Pages without and with grains."""
    times = 'frame_ms', 'step_ms', 'ground_ms', 'draw_ms'
    rows = [
        [f'{name}, {of}', row['bytes'] / 1e6, row['first_picture_s'],
         *(' / '.join(f'{value:.3g}' for value in found[key]) for key in times)]
        for name, row in files.read_json(path)['pages'].items()
        for of, found in row.items() if isinstance(found, dict)
    ]  # fmt: skip
    header = ('page', 'MB', 'first picture, s', 'from frame to frame, ms', 'step, ms',
              'ground and grains, ms', 'drawing, ms')  # fmt: skip
    return markdown.table(header, rows)


def define_flags() -> None:
    flags.DEFINE_string('output_path', None, 'JSON file to write.', required=True)
    flags.DEFINE_string('screenshots_path', None, 'Folder for pictures of the pages; none else.')


def main(values) -> None:
    from learning_to_simulate.native import web_page

    found: dict[str, Any] = record.provenance() | {'window': SIZE, 'pages': {}}
    if values.screenshots_path:
        os.makedirs(values.screenshots_path, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, browser() as chromium:
        for name in MODELS:
            path = pathlib.Path(folder, f'{name}.html')
            web_page.export(name, str(path), f'datasets/{name}')
            found['pages'][name] = measured(chromium, path, values.screenshots_path)
            print(name, found['pages'][name], file=sys.stderr)
    files.write_json(values.output_path, found)
    print(table(values.output_path))
