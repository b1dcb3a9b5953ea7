"""Damaged and forged versions of valid files, each a function of one random generator.

`damage` changes bytes as disks, transfers and editors do. `forge` changes what the file says and
makes its checksums right again, as somebody with bad intentions would: what a reader must then
judge is the content.
"""

import copy
import io
import json
import math
import random
import re
import struct
import zipfile

import numpy as np

from pca_tools.tfrecord_io import masked_crc32c

_INTEGERS = (0, 1, -1, 127, 255, 256, 2**15, 2**31 - 1, 2**31, 2**32, 2**36, 2**62, 2**63, 2**64)
_VALUES: tuple = (
    None, True, False, 0, 1, -1, 3, 0.5, 1e-320, 1e308, -1e308, math.nan, math.inf, 2**31, 2**53,
    2**70, -(2**70), 1e400, '', 'x', '0', '../../etc/passwd', '\ud800', [], {}, [[]], [0], [None],
    {'a': 1}, 'x' * 3000,
)  # fmt: skip
_POINTER = b'version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 190515362\n'


def damage(data: bytes, rng: random.Random) -> bytes:
    """One to three changes of bytes."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        i, elsewhere = (rng.randrange(len(data) + 1) for _ in range(2))
        j = min(i + rng.choice((1, 2, 4, 8, 16, 64, 1000)), len(data))
        before, span, after = data[:i], data[i:j], data[j:]
        flipped = bytes([b ^ 1 << rng.randrange(8) for b in span[:1]]) + span[1:]
        size = rng.choice((2, 4, 8))
        number = rng.choice(_INTEGERS) % 2 ** (8 * size)
        number = number.to_bytes(size, rng.choice(('little', 'big'))) + data[i + size :]
        end = rng.choice((b'\n' * 7, bytes(64), rng.randbytes(20), data[:100], data))
        others = b'', _POINTER, b'\x89PNG\r\n', bytes(len(data)), rng.randbytes(200)
        changed = {
            'a bit': before + flipped + after,
            'a number': before + number,
            'cut off': before,
            'cut out': before + after,
            'repeated': before + span * rng.choice((2, 3, 51)) + after,
            'zeros': before + bytes(len(span)) + after,
            'noise': before + rng.randbytes(len(span)) + after,
            'inserted': before + rng.randbytes(rng.choice((1, 7, 64))) + span + after,
            'appended': data + end,
            'spliced': before + data[elsewhere:],
            'another file': rng.choice(others),
        }
        data = changed[rng.choice(['a bit', 'a bit', 'a number', *changed])]
    return data


def forge(name: str, data: bytes, rng: random.Random) -> bytes:
    """Changes the valid content of a file by its kind, as its ending says, with right checksums."""
    ending = name.rpartition('.')[2]
    kinds = {'json': _forge_json, 'npz': _forge_npz, 'npy': _forge_npy}
    return (kinds | {'tfrecord': _forge_records}).get(ending, damage)(data, rng)


def _forge_json(data, rng):
    root = [json.loads(data)]
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        places = list(_places(root))
        parent, key = rng.choice(places)
        action = rng.randrange(6)
        if action == 0 and parent is not root:
            del parent[key]
        elif action == 1 and isinstance(parent, list):
            parent.insert(rng.randrange(len(parent) + 1), copy.deepcopy(parent[key]))
        elif action == 2 and isinstance(parent[key], (int, float)):
            factor = rng.choice((-1, 0, 2, 1000, 1e-30))
            parent[key] = parent[key] * factor
        elif action == 3 and isinstance(parent, dict):
            parent[rng.choice(('x', 'case', '__class__', ''))] = copy.deepcopy(parent[key])
        elif action == 4:
            other, index = rng.choice(places)
            parent[key] = copy.deepcopy(other[index])
        else:
            parent[key] = copy.deepcopy(rng.choice(_VALUES))  # later changes go into it
    text = json.dumps(root[0])
    if rng.random() < 0.02:  # deeper than any parser's stack
        text = text[:-1] + ', "deep": ' + '[' * 5000 + ']' * 5000 + '}'
    return text.encode('utf-8', 'surrogatepass')


def _places(value):
    """(container, key) of everything inside a JSON value."""
    if isinstance(value, (dict, list)):
        for key in list(value) if isinstance(value, dict) else range(len(value)):
            yield value, key
            yield from _places(value[key])


def _forge_npz(data, rng):
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    name = rng.choice(sorted(members))
    action = rng.randrange(8)
    if action == 0:
        del members[name]
    elif action == 1:
        members[rng.choice(('evil.npy', '../evil.npy', '/evil.npy', 'evil.py'))] = members[name]
    elif action == 2:
        members[name] = members[rng.choice(sorted(members))]
    else:
        members[name] = _forge_npy(members[name], rng)
    methods = (zipfile.ZIP_DEFLATED,) * 6 + (zipfile.ZIP_STORED, zipfile.ZIP_BZIP2)
    stream = io.BytesIO()
    method = rng.choice(methods)
    with zipfile.ZipFile(stream, 'w') as archive:
        for member, content in members.items():
            # With a date of its own: by a name alone it takes that of the clock.
            archive.writestr(zipfile.ZipInfo(member), content, method)
    forged = stream.getvalue()
    if rng.random() < 0.1:  # lie about sizes, flags and methods in the directory of the archive
        if b'PK\x01\x02' not in forged:  # its only member was taken out
            return bytes(forged)
        at = forged.rindex(b'PK\x01\x02') + rng.choice((8, 10, 20, 24, 42))
        number = rng.choice(_INTEGERS) % 2**32
        forged = forged[:at] + struct.pack('<I', number) + forged[at + 4 :]
    return forged


def _forge_npy(data, rng):
    action = rng.randrange(5)
    if action == 0:
        return damage(data, rng)
    if action == 1:  # another shape or type in the header, padded to the same length
        head = data[: data.index(b'\n') + 1]
        shape = rng.choice(
            ('(9,)', '()', '(0,)', '(-1,)', '(1000000, 1000000)', '(0, 10000000000000000000000)')
        )
        text = re.sub(rb'\([^)]*\)', shape.encode(), head, count=1)
        if rng.random() < 0.5:
            kind = rng.choice(('<f2', '|O', '<U0', '|V0', '<c16', '>f8', '|b1', '<M8[s]', '<U9'))
            text = re.sub(rb"'descr': '[^']*'", f"'descr': '{kind}'".encode(), text, count=1)
        text = text.rstrip(b' \n')[:117].ljust(len(head) - 1) + b'\n'
        return text[:8] + struct.pack('<H', len(text) - 10) + text[10:] + data[len(head) :]
    try:
        array = np.load(io.BytesIO(data))
    except ValueError:  # an array of objects: its pickle is damaged instead
        return damage(data, rng)
    flat = array.reshape(-1).copy()
    if action == 2 and flat.size and array.dtype.kind in 'fiu':
        values = np.array([0, -1, 1e30, math.nan, math.inf, 7, 1e-30])
        with np.errstate(all='ignore'):
            flat[rng.randrange(flat.size)] = values[rng.randrange(7)].astype(array.dtype)
        changed = flat.reshape(array.shape)
    elif action == 3 and array.ndim:
        end = rng.randrange(len(array) + 1)
        changed = rng.choice((array[:end], array[None], array.T, np.repeat(array, 2, axis=0)))
    else:
        kinds = ('f2', 'f8', 'i4', 'c16', 'U3', 'S3', 'b1', 'M8[s]')
        try:
            with np.errstate(all='ignore'):
                changed = array.astype(rng.choice(kinds))
        except (ValueError, TypeError):
            changed = np.zeros(array.shape, rng.choice(kinds))
    stream = io.BytesIO()
    np.save(stream, changed)
    return stream.getvalue()


def _forge_records(data, rng):
    payloads, offset = [], 0
    while offset < len(data):
        (length,) = struct.unpack_from('<Q', data, offset)
        payloads.append(data[offset + 12 : offset + 12 + length])
        offset += 16 + length
    action, at = rng.randrange(8), rng.randrange(len(payloads))
    if action == 0:  # a length that the file does not have, under a right checksum
        header = struct.pack('<Q', rng.choice(_INTEGERS) % 2**64)
        lie = header + struct.pack('<I', masked_crc32c(header))
        return b''.join(map(_framed, payloads[:at])) + lie + payloads[at]
    if action == 1:
        payloads.insert(at, rng.choice(payloads))
    elif action == 2:
        del payloads[at]
    else:
        payloads[at] = damage(payloads[at], rng)
    return b''.join(map(_framed, payloads))


def _framed(payload):
    parts = struct.pack('<Q', len(payload)), payload
    return b''.join(part + struct.pack('<I', masked_crc32c(part)) for part in parts)
