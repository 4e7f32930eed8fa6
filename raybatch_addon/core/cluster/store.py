"""Arrays on a machine's disk, by digest, for all processes there."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import numpy as np

from ..errors import RayBatchError
from ..files import whole_file
from .parts import part_digest

# What may stay for renders to come [bytes]
KEPT_BYTES = 16 << 30


class PartMissing(RayBatchError):
    """A part is not there, or damaged: it has to be sent (again)."""


class StoreError(RayBatchError):
    """Parts cannot be kept on this machine."""


class PartStore:
    """The parts in a folder. Files are whole or not there, and never changed; several processes share them."""

    def __init__(self, folder: Path, kept_bytes: int = KEPT_BYTES):
        self._folder, self._kept_bytes = Path(folder), kept_bytes

    def lacks(self, digests: list[str]) -> list[str]:
        """Those of `digests` that are not there. The others are kept for longer from now on."""
        lacking = []
        for digest in digests:
            try:
                os.utime(self._path(digest))
            except OSError:
                lacking.append(digest)
        return lacking

    def put(self, arrays: dict[str, np.ndarray]) -> None:
        """Keep `arrays`, by their digests; raises `PartMissing` where one is another than its digest says, `StoreError`
        where they have no room.
        """
        for digest, array in arrays.items():
            if part_digest(array) != digest:
                raise PartMissing(f"part {digest} was damaged on its way")
        lacking = {digest: array for digest, array in arrays.items() if not self._path(digest).exists()}
        if not lacking:
            return
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._make_room(sum(array.nbytes for array in lacking.values()))
            for digest, array in lacking.items():
                with whole_file(self._path(digest)) as temporary, temporary.open("wb") as file:
                    np.lib.format.write_array(file, np.ascontiguousarray(array), allow_pickle=False)
        except OSError as error:
            raise StoreError(
                f"{self._folder} cannot keep a part: {error.strerror or error}; make room there, or name another "
                "folder by RAYBATCH_PART_FOLDER"
            ) from error

    def load(self, digest: str) -> np.ndarray:
        """The array, which lies in the file as long as it is read from there; raises `PartMissing`."""
        path = self._path(digest)
        try:
            if path.stat().st_size > 1 << 20:
                array = np.load(path, mmap_mode="r", allow_pickle=False)
            else:
                array = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise PartMissing(f"part {digest} cannot be read: {error}") from error
        if part_digest(array) != digest:
            with contextlib.suppress(OSError):
                path.unlink()
            raise PartMissing(f"part {digest} is damaged")
        return array

    def _path(self, digest: str) -> Path:
        return self._folder / f"{digest}.npy"

    def _make_room(self, size: int) -> None:
        """Remove what was not asked for for longest, until `size` more bytes fit."""
        found = []
        for path in self._folder.glob("*.npy"):
            with contextlib.suppress(OSError):
                stat = path.stat()
                found.append((stat.st_mtime, stat.st_size, path))
        total = sum(each[1] for each in found) + size
        for _, own, path in sorted(found):
            if total <= self._kept_bytes:
                break
            with contextlib.suppress(OSError):
                path.unlink()
                total -= own
