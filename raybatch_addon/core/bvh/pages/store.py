"""Pages of geometry behind the device: in host memory, or in a file.

A page is a run of whole treelets (`tree.Treelets`) that is brought to the device as one. In a store it is a run of
*segments*, each of one kind (nodes of its treelets; their triangles), padded to `PAGE_ALIGNMENT`, with a checksum of
its own.
"""

from __future__ import annotations

import contextlib
import errno
import os
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import warp as wp

from ...device.locked import locked_empty
from ...errors import OutOfMemoryError, RayBatchError
from ...native.structs import to_numpy

# Where reads without the system's cache must begin and end, in the file and in memory [bytes]
PAGE_ALIGNMENT = 4096
# Pages of a host store smaller than this lie together in blocks of so many bytes: pinning memory takes a call each
_BLOCK_BYTES = 1 << 26


class PageFileError(RayBatchError, OSError):
    """A file of pages that cannot be written, or read."""


@dataclass(frozen=True)
class Page:
    """A run of whole treelets."""

    treelet_first: int
    treelet_count: int
    byte_first: int  # in the store, a multiple of `PAGE_ALIGNMENT`
    byte_count: int  # in the store, likewise
    device_bytes: int  # on the device: those of the store, or more where the store's are encoded


class Segments:
    """Runs of bytes of a store that are checked as one: in rising order, without gaps between those of a page."""

    def __init__(self, first: np.ndarray, count: np.ndarray, checksum: np.ndarray):
        """`first` and `count` int64 [bytes], `checksum` uint32 (CRC-32, of whole padded segments); shape [n] each."""
        self.first, self.count, self.checksum = first, count, checksum
        self._good = np.zeros(len(first), bool)

    def wrong(self, byte_first: int, data: np.ndarray) -> bool:
        """Whether `data`, read at `byte_first`, is not what was written. Each segment is looked at once."""
        i = int(np.searchsorted(self.first, byte_first))
        end = byte_first + len(data)
        while i < len(self.first) and self.first[i] + self.count[i] <= end:
            start = int(self.first[i]) - byte_first
            if not self._good[i]:
                if zlib.crc32(data[start : start + int(self.count[i])]) != int(self.checksum[i]):
                    return True
                self._good[i] = True
            i += 1
        return False


class PageStore(Protocol):
    """The pages of a scene, in memory or in a file."""

    byte_count: int  # of all pages

    def read_into(self, page: Page, host: np.ndarray, direct: bool) -> None:
        """Copy a page to the beginning of `host`, uint8; callable from any thread.

        With `direct` the system keeps no copy: one that begins at a multiple of `PAGE_ALIGNMENT` (`page_buffer`) is
        read fastest. Raises `PageFileError`.
        """

    def view(self, page: Page) -> wp.array | None:
        """The page where it lies, uint8, pinned where there is a CUDA device; None where it is not in memory."""

    def close(self) -> None:
        """Release files and memory."""


def padded(byte_count: int) -> int:
    """`byte_count` rounded up to a multiple of `PAGE_ALIGNMENT`."""
    return -(-byte_count // PAGE_ALIGNMENT) * PAGE_ALIGNMENT


def page_buffer(byte_count: int, pinned: bool = False) -> wp.array:
    """Host memory without contents, uint8, that begins at a multiple of `PAGE_ALIGNMENT`; raises `OutOfMemoryError`."""
    try:
        if pinned:
            return locked_empty(byte_count, wp.uint8, hurry=False)
        memory = wp.empty(byte_count + PAGE_ALIGNMENT, dtype=wp.uint8, device="cpu")
    except (MemoryError, RuntimeError) as error:
        kind = "locked " if pinned else ""
        raise OutOfMemoryError(
            f"{byte_count:,} bytes of {kind}memory could not be had for geometry; close other programs, or use DISK"
        ) from error
    start = -memory.ptr % PAGE_ALIGNMENT
    return memory[start : start + byte_count]


def page_rows(byte_count: int, device: wp.Device) -> wp.array:
    """Memory without contents on `device`, uint8, shape [rows, PAGE_ALIGNMENT], for pages one after another.

    It has rows because one dimension of an array has less than 2^31 elements. On a CPU it begins at a multiple of
    `PAGE_ALIGNMENT`.
    """
    shape = (max(padded(byte_count) // PAGE_ALIGNMENT, 1), PAGE_ALIGNMENT)
    if device.is_cuda:
        return wp.empty(shape, dtype=wp.uint8, device=device)
    memory = np.empty((shape[0] + 1) * PAGE_ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % PAGE_ALIGNMENT
    host = memory[start : start + shape[0] * PAGE_ALIGNMENT].reshape(shape)
    return wp.array(host, dtype=wp.uint8, device=device, copy=False)


def bytes_of_rows(rows: wp.array, first: int, byte_count: int) -> wp.array:
    """View of so many bytes of `rows`, at least one, from byte `first` on, a multiple of `PAGE_ALIGNMENT`; uint8, shape
    [byte_count].
    """
    start = first // PAGE_ALIGNMENT
    return rows[start : start + padded(byte_count) // PAGE_ALIGNMENT].flatten()[:byte_count]


class HostStore:
    """Pages in host memory; pinned, so that a CUDA device copies from it, or reads it, by itself."""

    def __init__(self, pinned: bool):
        """Empty; `pinned` where there is a CUDA device."""
        self._pinned = pinned
        self._blocks: list[wp.array] = []
        self._ends: list[int] = []  # of the blocks, in the store's own count
        self._used = 0
        self.byte_count = 0

    def add(self, size: int) -> tuple[int, np.ndarray]:
        """Room for a page of `size` bytes behind the others: where it begins, and its memory."""
        size = padded(size)
        if not self._blocks or self._used + size > self._ends[-1]:
            first = self._ends[-1] if self._ends else 0
            block = page_buffer(size if size >= _BLOCK_BYTES // 4 else _BLOCK_BYTES, self._pinned)
            self._blocks.append(block)
            self._ends.append(first + block.size)
            self._used = first
        first = self._used
        self._used += size
        self.byte_count += size
        return first, to_numpy(self.at(first, size))

    def read_into(self, page: Page, host: np.ndarray, direct: bool) -> None:
        """See `PageStore`."""
        host[: page.byte_count] = to_numpy(self.view(page))

    def view(self, page: Page) -> wp.array:
        """See `PageStore`."""
        return self.at(page.byte_first, page.byte_count)

    def close(self) -> None:
        """See `PageStore`; views must not be used any more."""
        self._blocks, self._ends, self._used = [], [], 0

    def at(self, first: int, size: int) -> wp.array:
        """A view of `size` bytes of a page, from byte `first` of the store on."""
        i = int(np.searchsorted(self._ends, first, side="right"))
        start = first - (self._ends[i] - self._blocks[i].size)
        return self._blocks[i][start : start + size]


class DiskStore:
    """Pages in a file, which `file.py` has written or found."""

    def __init__(self, path: Path, segments: Segments, byte_count: int):
        """Open the pages of the file at `path`; raises `PageFileError`."""
        self.path, self.byte_count = path, byte_count
        self._segments = segments
        self._direct, self._refuses_direct = -1, False
        try:
            self._file = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
            if hasattr(os, "O_DIRECT"):
                # not every file system has it
                with contextlib.suppress(OSError):
                    self._direct = os.open(path, os.O_RDONLY | os.O_DIRECT)
        except OSError as error:
            raise PageFileError(
                f"the file of geometry {path} cannot be opened ({error.strerror}); delete it and render again"
            ) from error

    def __del__(self):
        self.close()

    def read_into(self, page: Page, host: np.ndarray, direct: bool) -> None:
        """See `PageStore`."""
        data = host[: page.byte_count]
        self.read(page.byte_first, data, direct)
        if self._segments.wrong(page.byte_first, data):
            self._spoil()
            raise PageFileError(
                f"the file of geometry {self.path} was damaged: the page at byte {page.byte_first:,} is not what was "
                "written; "
                "render again, which writes it anew"
            )

    def view(self, page: Page) -> None:
        """See `PageStore`: pages are not in memory."""
        return

    def _spoil(self) -> None:
        """Make sure that nobody takes the file for a sound one any more."""
        try:
            self.path.unlink()
        except OSError:
            # a system may not delete what is open: then its header goes
            with contextlib.suppress(OSError), open(self.path, "r+b") as file:
                file.write(bytes(PAGE_ALIGNMENT))

    def close(self) -> None:
        """See `PageStore`."""
        for name in ("_file", "_direct"):
            number = getattr(self, name, -1)
            setattr(self, name, -1)
            if number >= 0:
                os.close(number)

    def read(self, first: int, data: np.ndarray, direct: bool) -> None:
        """Fill `data`, uint8, from `first` on; raises `PageFileError`."""
        aligned = (first | data.nbytes | data.ctypes.data) % PAGE_ALIGNMENT == 0
        try:
            if direct and aligned and self._direct >= 0 and not self._refuses_direct:
                try:
                    self._read(self._direct, first, data)
                    return
                except OSError as error:
                    # a file system may refuse it only now
                    if error.errno != errno.EINVAL:
                        raise
                    self._refuses_direct = True
            self._read(self._file, first, data)
            if direct and hasattr(os, "posix_fadvise"):
                os.posix_fadvise(self._file, first, data.nbytes, os.POSIX_FADV_DONTNEED)
        except OSError as error:
            if isinstance(error, PageFileError):
                raise
            raise PageFileError(
                f"the file of geometry {self.path} cannot be read ({error.strerror}); delete it and render again"
            ) from error

    def _read(self, number: int, first: int, data: np.ndarray) -> None:
        rest = memoryview(data)
        while len(rest):
            if hasattr(os, "preadv"):
                count = os.preadv(number, [rest], first)
            else:
                with open(self.path, "rb", buffering=0) as file:
                    file.seek(first)
                    count = file.readinto(rest)
            if not count:
                raise PageFileError(f"the file of geometry {self.path} ends too early; delete it and render again")
            first, rest = first + count, rest[count:]
