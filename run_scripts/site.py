"""Builds the documents as a site, `build/site`, with the page that they embed.

python -m run_scripts.site           # needs the extras page and dev
zensical serve                       # then shows the site while the documents change
"""

import pathlib
import re
import subprocess
import sys

from learning_to_simulate.native import web_page

ROOT = pathlib.Path(__file__).resolve().parents[1]


def build(root: pathlib.Path = ROOT) -> pathlib.Path:
    """The folder of the site of `mkdocs.yml` and `docs/` below a root; ValueError: the page cannot
    be written, a warning of the build, or a frame that shows nothing."""
    web_page.export('excavation', str(root / 'docs/blade.html'), 'datasets/excavation')
    done = subprocess.run(
        [sys.executable, '-m', 'zensical', 'build', '--strict'],
        cwd=root, capture_output=True, text=True,
    )  # fmt: skip
    if done.returncode:
        raise ValueError(f'the site was not built:\n{done.stdout}{done.stderr}')
    site = root / 'build/site'
    for path in site.rglob('*.html'):
        for frame in re.findall(r'<iframe[^>]* src="([^"]*)"', path.read_text(encoding='utf-8')):
            if not (path.parent / frame).is_file():
                raise ValueError(f'{path.relative_to(site)} shows {frame}, which is not there')
    return site


if __name__ == '__main__':
    try:
        print(f'wrote {build()}')
    except ValueError as error:
        sys.exit(f'error: {error}')
