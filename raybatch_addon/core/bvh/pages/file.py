"""Files of pages: written once, found again by what they were made from, and checked.

A file is a header of `PAGE_ALIGNMENT` bytes, the pages' segments, and an index: NumPy arrays with everything that is
kept of the build, the first byte, size and checksum of each segment among it. It is written under another name and gets
its own when it is whole: not by `files.whole_file`, as it is written while the build goes on, by several calls, and its
bytes have to be on the disk before the name says that they are.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import struct
import time
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ..node import Layout
from .store import PAGE_ALIGNMENT, DiskStore, PageFileError, Segments, padded

VERSION = 1  # of the files; counts up with every change of what they hold
SUFFIX = ".pages"
# Files of earlier scenes are deleted, least recently used first, when all of them together are larger [bytes]
KEPT_BYTES_MAX = 64 << 30
# What a process that died has left half written is deleted when it is so old [s]
_LEFT_SECONDS = 24 * 3600
# Bytes after which the disk is waited for: it writes while pages are made, and there is little left to do at the end
_SYNCED_BYTES = 1 << 28
_MAGIC = b"RBPAGES\0"
# magic, version, layout, key, size of the file, first byte and size of the index, its checksum; then the checksum of
# all these
_HEADER = struct.Struct("<8sII32sQQQI")


def page_path(folder: Path, key: bytes) -> Path:
    """The file in `folder` of the scene with this key."""
    return folder / f"{key.hex()[:32]}{SUFFIX}"


class PageFileWriter:
    """Writes a file of pages: `add` for each segment, then `finish`; or `abandon`, which leaves nothing behind."""

    def __init__(self, folder: Path, layout: Layout, key: bytes, expected_bytes: int):
        """Begin a file in `folder`, which is made; raises `PageFileError` where it cannot be, or has not room for about
        `expected_bytes`.
        """
        self.path = page_path(folder, key)
        self._layout, self._key = layout, key
        self._temporary = folder / f"{self.path.name}.{os.getpid()}-{time.time_ns():x}.part"
        self._segments: list[tuple[int, int, int]] = []
        self._end = self._synced = PAGE_ALIGNMENT
        self._file = None
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _make_room(folder, expected_bytes)
            self._file = open(self._temporary, "xb", buffering=0)  # noqa: SIM115 (kept open)
            self._file.seek(PAGE_ALIGNMENT)  # the header comes last
        except PageFileError:
            raise
        except OSError as error:
            raise PageFileError(
                f"geometry cannot be kept in {folder} ({error.strerror}); make it writable, choose another folder, or "
                "HOST memory"
            ) from error

    def add(self, data: np.ndarray, checksum: int | None = None) -> int:
        """Append a segment, uint8, of whole `PAGE_ALIGNMENT`; returns its first byte. Raises `PageFileError`."""
        first = self._end
        self._segments.append((first, len(data), zlib.crc32(data) if checksum is None else checksum))
        self._write(data)
        self._end += len(data)
        if self._end - self._synced >= _SYNCED_BYTES:
            self._sync()
        return first

    def add_page(self, memory: np.ndarray, node_bytes: int) -> int:
        """See `PageTarget`; raises `PageFileError`."""
        first = self.add(memory[:node_bytes])
        self.add(memory[node_bytes:])
        return first

    def finish(self, index: dict[str, np.ndarray]) -> DiskStore:
        """Complete the file with what else is kept, and open it. Raises `PageFileError`."""
        memory = io.BytesIO()
        np.savez(memory, **index, **self._segment_index())
        data = memory.getvalue()
        room = padded(len(data)) - len(data)
        self._write(np.frombuffer(data + bytes(room), np.uint8))
        number, size = _layout_number(self._layout), self._end + len(data) + room
        header = _HEADER.pack(_MAGIC, VERSION, number, self._key, size, self._end, len(data), zlib.crc32(data))
        header += struct.pack("<I", zlib.crc32(header))
        try:
            self._file.seek(0)
            self._write(np.frombuffer(header, np.uint8))
            os.fsync(self._file.fileno())
            if hasattr(os, "posix_fadvise"):
                # the memory is for other things
                os.posix_fadvise(self._file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
            self._file.close()
            os.replace(self._temporary, self.path)
        except PageFileError:
            raise
        except OSError as error:
            self._fail(error)
        return DiskStore(self.path, _segments(self._segment_index()), self._end - PAGE_ALIGNMENT)

    def abandon(self) -> None:
        """Delete what was written."""
        if self._file is not None:
            self._file.close()
        with contextlib.suppress(OSError):
            self._temporary.unlink()

    def _segment_index(self) -> dict[str, np.ndarray]:
        table = np.array(self._segments, np.int64).reshape(-1, 3)
        return {
            "segment_first": table[:, 0],
            "segment_bytes": table[:, 1],
            "segment_checksum": table[:, 2].astype(np.uint32),
        }

    def _write(self, data: np.ndarray) -> None:
        rest = memoryview(data)
        try:
            while len(rest):
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            self._fail(error)

    def _sync(self) -> None:
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            self._fail(error)
        self._synced = self._end

    def _fail(self, error: OSError) -> None:
        self.abandon()
        raise PageFileError(
            f"geometry cannot be written to {self.path.parent} ({error.strerror}) after {self._end:,} bytes; free some "
            "space, choose "
            "another folder, or HOST memory. Nothing was left there"
        ) from error


def open_page_file(folder: Path, layout: Layout, key: bytes) -> tuple[DiskStore, dict[str, np.ndarray]] | str | None:
    """The pages of the scene with this key and what else was kept; None where there is no file; what is wrong with a
    useless one.

    Pages are checked when they are read.
    """
    path = page_path(folder, key)
    try:
        with open(path, "rb") as file:
            head = file.read(PAGE_ALIGNMENT)
            size = os.fstat(file.fileno()).st_size
            if len(head) < _HEADER.size + 4:
                return f"{path} is too short"
            magic, version, number, found_key, file_bytes, first, count, checksum = _HEADER.unpack_from(head)
            if magic != _MAGIC:
                return f"{path} is no file of pages"
            if version != VERSION:
                return f"{path} is of version {version}, and this is version {VERSION}"
            if zlib.crc32(head[: _HEADER.size]) != struct.unpack_from("<I", head, _HEADER.size)[0]:
                return f"{path} was altered"
            if found_key != key or number != _layout_number(layout):
                return f"{path} is of another scene"
            if size != file_bytes or first + count > size:
                return f"{path} is of {size:,} bytes and should be of {file_bytes:,}"
            file.seek(first)
            data = file.read(count)
        if zlib.crc32(data) != checksum:
            return f"{path} was altered"
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            index = dict(arrays)
        store = DiskStore(path, _segments(index), first - PAGE_ALIGNMENT)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, zipfile.BadZipFile, struct.error) as error:
        return f"{path} cannot be read ({error})"
    with contextlib.suppress(OSError):
        os.utime(path)  # it was used now
    return store, index


def delete_old_files(folder: Path, kept: Path | None = None, bytes_max: int = KEPT_BYTES_MAX) -> list[Path]:
    """Delete files of pages in `folder`, least recently used first, until all of them, `kept` among them, have at most
    `bytes_max`.

    Returns what was deleted, half-written files that somebody left among it.
    """
    deleted = []
    with contextlib.suppress(OSError):
        for used, _, path in _by_age(folder.glob(f"*{SUFFIX}.*.part")):
            if time.time() - used > _LEFT_SECONDS and _deleted(path):
                deleted.append(path)
        files = _by_age(folder.glob(f"*{SUFFIX}"))
        total = sum(size for _, size, path in files if path == kept)
        for _, size, path in reversed(files):
            if path == kept:
                continue
            total += size
            if total > bytes_max and _deleted(path):
                total -= size
                deleted.append(path)
    return deleted


def _make_room(folder: Path, needed: int) -> None:
    """Delete old files until there is room; raises `PageFileError` where there would not be."""
    delete_old_files(folder, None, max(KEPT_BYTES_MAX - needed, 0))
    files = _by_age(folder.glob(f"*{SUFFIX}"))
    helps = shutil.disk_usage(folder).free + sum(size for _, size, _ in files) >= needed
    while (free := shutil.disk_usage(folder).free) < needed:
        if not (helps and files):
            raise PageFileError(
                f"the scene's geometry takes about {needed / 1e9:.2f} GB in {folder}, and {free / 1e9:.2f} GB are free "
                "there; free some space, "
                "choose another folder, or HOST memory"
            )
        _deleted(files.pop(0)[2])


def _by_age(paths: Iterable[Path]) -> list[tuple[float, int, Path]]:
    """When each was used last [s], its size [bytes] and itself, the oldest first; without those that another process
    deletes meanwhile.
    """
    found = []
    for path in paths:
        with contextlib.suppress(FileNotFoundError):
            known = path.stat()
            found.append((known.st_mtime, known.st_size, path))
    return sorted(found)


def _deleted(path: Path) -> bool:
    try:
        path.unlink()
    except OSError:
        return False  # in use, where the system minds that
    return True


def _segments(index: dict[str, np.ndarray]) -> Segments:
    return Segments(index["segment_first"], index["segment_bytes"], index["segment_checksum"])


def _layout_number(layout: Layout) -> int:
    return list(Layout).index(layout)
