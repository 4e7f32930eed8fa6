"""The headers of OpenVDB files: libraries that read one that is cut off ask for as much memory as there is, or more."""

from __future__ import annotations

import struct
from typing import BinaryIO

_MAGIC = 0x56444220
# Files of older versions have other headers, and are not looked at
_VERSION_LEAST = 222
_UUID_BYTES = 36


class _CutOff(Exception):
    """The file ends before its header does."""


def header_is_whole(file: BinaryIO, size: int) -> bool:
    """Whether an OpenVDB file of `size` bytes, open at its beginning, has its header and what describes its grids, as
    far as these can be found; True for files that are none. Layout as in
    OpenVDB 12, `io/Archive.cc` and `io/GridDescriptor.cc`.
    """
    try:
        return _descriptions_fit(file, size)
    except _CutOff:
        return False


def _descriptions_fit(file: BinaryIO, size: int) -> bool:
    magic, version = _numbers(file, "<qI")
    if magic != _MAGIC or version < _VERSION_LEAST:
        return True
    *_, has_offsets = _numbers(file, "<IIB")
    _bytes(file, _UUID_BYTES)
    _values(file, size)
    (grid_count,) = _numbers(file, "<I")
    for _ in range(grid_count):
        for _ in range(3):  # name, type and the name of the grid whose tree it has
            _block(file, size)
        begin, _, end = _numbers(file, "<qqq")
        if not has_offsets:
            return True  # what is behind cannot be found
        file.seek(begin)
        _numbers(file, "<I")  # how it is compressed
        _values(file, size)
        if end > size:
            return True  # what of the grid itself is cut off is for the library to say
        file.seek(end)
    return True


def _values(file: BinaryIO, size: int) -> None:
    """Pass values by name: of the file, or of a grid."""
    (count,) = _numbers(file, "<I")
    for _ in range(count):
        for _ in range(3):  # name, type and value
            _block(file, size)


def _numbers(file: BinaryIO, layout: str) -> tuple[int, ...]:
    return struct.unpack(layout, _bytes(file, struct.calcsize(layout)))


def _bytes(file: BinaryIO, count: int) -> bytes:
    found = file.read(count)
    if len(found) < count:
        raise _CutOff
    return found


def _block(file: BinaryIO, size: int) -> None:
    """Pass a number of bytes and as many bytes."""
    (count,) = _numbers(file, "<I")
    if file.tell() + count > size:
        raise _CutOff
    file.seek(count, 1)
