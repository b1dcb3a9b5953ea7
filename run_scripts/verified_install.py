"""Installs the project with every package held against its sha256 in `hashes.txt`.

`pip -c constraints.txt` pins versions; a file that was exchanged under a pinned version would still
be taken. Here pip takes only files of the listed digests (Linux x86-64, Python 3.11 to 3.13) and
resolves nothing: what an extra needs is written beside each package. Standard library only.

Examples:
    python3.11 -m venv .venv
    .venv/bin/python run_scripts/verified_install.py cpu,viz,dev

    # hashes.txt again, after a change of constraints.txt; needs uv
    python run_scripts/verified_install.py --make
"""

import pathlib
import re
import subprocess
import sys
import tempfile
import tomllib

ROOT = pathlib.Path(__file__).resolve().parents[1]
CORE, TOOLS = 'core', ('pip', 'setuptools', 'wheel')
# One package: name==version, its digests, and after the number sign who needs it.
_LINE = re.compile(r'([\w.-]+)==(\S+) .*# ([\w, ]+)')
_WHEELS = re.compile(r'-(?:cp31[123]|cp3\d+-abi3|py3|py2\.py3)-.*(?:manylinux\w*x86_64|none-any)')


def extras() -> list[str]:
    """The extras of setup.py, by its text: nothing is run."""
    block = (ROOT / 'setup.py').read_text(encoding='utf-8').split('EXTRAS = {')[1].split('\n}')[0]
    return re.findall(r"^    '(\w+)':", block, re.M)


def chosen_lines(text: str, wanted: list[str]) -> list[str]:
    """The lines of `hashes.txt` that a choice of extras needs.

    Raises:
        ValueError: an extra that there is not.
    """
    if unknown := set(wanted) - set(extras()):
        raise ValueError(f'no extras {sorted(unknown)}; there are {", ".join(extras())}')
    needed = {CORE, *wanted}
    found = (_LINE.match(line) for line in text.splitlines())
    return [match[0] for match in found if match and needed & set(match[3].split(', '))]


def install(wanted: list[str]) -> None:
    """Installs the project into the environment of this interpreter.

    Raises:
        ValueError: an extra that there is not.
        subprocess.CalledProcessError: pip failed; a digest that differs is named by it.
    """
    lines = chosen_lines((ROOT / 'hashes.txt').read_text(encoding='utf-8'), wanted)
    pip = [sys.executable, '-m', 'pip', 'install', '--disable-pip-version-check']
    alone = ['--no-deps', '--no-build-isolation']
    tools = [line for line in lines if line.split('==')[0] in TOOLS]
    for part in (tools, [line for line in lines if line not in tools]):
        with tempfile.NamedTemporaryFile('w', suffix='.txt', encoding='utf-8') as file:
            file.write('\n'.join(part))
            file.flush()
            subprocess.run([*pip, *alone, '--require-hashes', '-r', file.name], check=True)
    subprocess.run([*pip, *alone, '-e', str(ROOT)], check=True)


def make() -> None:
    """Writes `hashes.txt` for the pins of `constraints.txt`, with uv."""
    pins = ['--constraint', str(ROOT / 'constraints.txt')]
    needed: dict[str, list[str]] = {name: [CORE] for name in TOOLS}
    for extra in (None, *extras()):
        chosen = ['--extra', extra] if extra else []
        for name in re.findall(r'^([\w.-]+)==', _uv('--no-annotate', *pins, *chosen), re.M):
            who = needed.setdefault(name, [])
            if CORE not in who:
                who.append(extra or CORE)
    with tempfile.TemporaryDirectory() as folder:
        lock = pathlib.Path(folder) / 'pylock.toml'
        tools = pathlib.Path(folder) / 'tools.in'
        tools.write_text('\n'.join(TOOLS), encoding='utf-8')
        _uv(str(tools), '--universal', '--all-extras', *pins, '--output-file', str(lock))
        packages = tomllib.loads(lock.read_text(encoding='utf-8'))['packages']
    lines = []
    for package in packages:
        # A package without a wheel is built from its source, with the tools of the list.
        found = [w for w in package.get('wheels', ()) if _WHEELS.search(w['url'])]
        found = found or [package['sdist']]
        if package['name'] in needed:
            digests = ' '.join(sorted(f'--hash=sha256:{f["hashes"]["sha256"]}' for f in found))
            users = ', '.join(needed[package['name']])
            lines.append(f'{package["name"]}=={package["version"]} {digests}  # {users}')
    head = '# Made by run_scripts/verified_install.py --make; wheels for Linux x86-64.\n'
    (ROOT / 'hashes.txt').write_text(head + '\n'.join(lines) + '\n', encoding='utf-8')


def _uv(*arguments: str) -> str:
    command = ['uv', 'pip', 'compile', 'setup.py', '--quiet', '--python-version', '3.11.7']
    done = subprocess.run(
        [*command, *arguments], cwd=ROOT, check=True, capture_output=True, text=True
    )
    return done.stdout


if __name__ == '__main__':
    if sys.argv[1:] == ['--make']:
        make()
    elif len(sys.argv) == 2 and not sys.argv[1].startswith('-'):
        try:
            install(sys.argv[1].split(','))
        except ValueError as error:
            sys.exit(f'error: {error}')
    else:
        print(__doc__)
