"""What the kernels share: the columns of the particle array, and how Numba compiles them.

Their arguments `block`, `nodes`, `grid`, `soil`, `body` and `law` are a `solver.Block`,
`solver.Nodes`, `grid.Grid`, `constitutive.Soil`, `bodies.Body` and `contact.ContactLaw`.
"""

import hashlib
import os

import numba

# Numba keeps compiled kernels beside the file that defines them and looks at that file alone when
# it decides whether they are stale; a kernel inlines functions of other files. So the place
# where they are kept, beside the files or where NUMBA_CACHE_DIR says, is named by the contents of
# all files that define any.
_FOLDER = os.path.dirname(os.path.abspath(__file__))
_digest = hashlib.sha256()
for _name in sorted(os.listdir(_FOLDER)):
    if _name.endswith('.py'):
        with open(os.path.join(_FOLDER, _name), 'rb') as _file:
            _source = _file.read()
        if b'@numba.njit' in _source or b'@intrinsic' in _source:
            _digest.update(_source)
_cache = os.environ.get('NUMBA_CACHE_DIR') or os.path.join(_FOLDER, '__pycache__')
numba.config.CACHE_DIR = os.path.join(_cache, _digest.hexdigest()[:16])

# Columns of the particle array [N, COLUMNS], float64: position X, velocity V and its gradient C
# (row by row), deviatoric stress S (xx, yy, zz, xy, yz, zx), volume over packed volume, GRIP: how
# far a body has dragged its contact with the particle (see `contact`).
# Row i is particle i, always. Kernels work on a copy of the rows that are awake.
X, V, C, S, VOLUME_RATIO, GRIP, COLUMNS = 0, 3, 6, 15, 21, 22, 25

# What the steps between two exchanges change of a particle (`solver.Block.elastic`): deviatoric
# stress and strain of volume, ELASTIC rows of CHUNK particles one after another, chunk by chunk.
CHUNK, ELASTIC = 64, 7

# Status codes of `solver.advance`.
OK, LEFT_GRID, TURNED_INSIDE_OUT = 0, 1, 2

# Fused multiply-adds only: permission to reorder sums made the gather a third slower and hides NaN.
JIT = dict(cache=True, fastmath={'contract'}, error_model='numpy')
# Node numbers are unsigned: Numba then leaves out the test for an index counted from the end.
index = numba.uintp


@numba.njit(inline='always', **JIT)
def row(c, number):
    """The place in row `number` of a chunk that is at c in row 0; the compiler knows the offset."""
    return c + index(number * CHUNK)
