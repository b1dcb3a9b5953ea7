"""Models and datasets that come with the project, by their names.

An installed copy holds the models (8 MB) inside of the package. The datasets (94 MB) are not
installed: they lie beside the models in the source tree only.
"""

import argparse
import os
from collections.abc import Sequence

_PACKAGE = os.path.dirname(os.path.abspath(__file__))
MARKERS = {'models': 'config.json', 'datasets': 'metadata.json'}
# What the name of a scene alone means as a model: the first of these that ships with it.
DEFAULT_MODELS = 'soil_field', 'pcg'
_REMEDIES = {
    'models': 'this copy has none: install it again (pip install .), its wheel holds them',
    'datasets': 'an installed copy has none: name a folder, such as datasets/excavation of the '
    'source tree, or make one with `lts generate` and `lts convert`',
}


def folder(kind: str) -> str:
    """Where what ships ('models' or 'datasets') lies: in the package if it is installed, beside it
    in the source tree."""
    installed = os.path.isdir(os.path.join(_PACKAGE, 'models'))
    return os.path.join(_PACKAGE if installed else os.path.dirname(_PACKAGE), kind)


def names(kind: str = 'models') -> list[str]:
    """The names of what ships, such as 'excavation/soil_field'; sorted."""
    top = folder(kind)
    return sorted(
        os.path.relpath(path, top).replace(os.sep, '/')
        for path, _, held in os.walk(top)
        if MARKERS[kind] in held
    )


def find(name: str, kind: str) -> str:
    """A folder that is given by its path, or by its name among those that ship; the name of a scene
    stands for its best model. FileNotFoundError: neither; the message lists what ships, or says
    where to get it."""
    name, top = os.fspath(name), folder(kind)
    deeper: Sequence[str] = DEFAULT_MODELS if kind == 'models' else ()
    for path in (name, *(os.path.join(top, name, part) for part in ('', *deeper))):
        if os.path.isfile(os.path.join(path, MARKERS[kind])):
            return os.path.normpath(path)
    known = names(kind)
    have = f'shipped are {", ".join(known)}' if known else _REMEDIES[kind]
    raise FileNotFoundError(f'{name}: no folder with a {MARKERS[kind]}; {have}')


if __name__ == '__main__':
    argparse.ArgumentParser(description='Prints the names of the models that ship.').parse_args()
    for each in names():
        print(each)
