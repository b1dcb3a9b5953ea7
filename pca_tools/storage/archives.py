"""Zip archives whose directory was damaged: what `zipfile` reads without a word."""

import struct
import zipfile

_END = b'PK\x05\x06'  # of the record that ends an archive; 22 bytes and a comment
_END_BYTES, _MAX_COMMENT, _IN_ZIP64 = 22, 2**16, 2**16 - 1


def refuse_lost_members(path: str, archive: zipfile.ZipFile) -> None:
    """Holds the members of an archive against the number that its last record states.

    One flipped bit in the length of a directory entry swallows the entries after it, and every
    member that is left has a right checksum.

    Raises:
        ValueError: with both numbers.
    """
    with open(path, 'rb') as file:
        file.seek(0, 2)
        file.seek(max(0, file.tell() - _END_BYTES - _MAX_COMMENT))
        tail = file.read()
    at = tail.rfind(_END)
    (stated,) = struct.unpack_from('<H', tail, at + 10) if at >= 0 else (0,)
    found = len(archive.infolist())
    if stated != _IN_ZIP64 and stated != found:
        raise ValueError(f'its directory lists {found} members, its end says {stated}')
