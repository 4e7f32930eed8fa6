"""Folders for half-written files."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from lib.output import OutputError, print_saved

_WORKSHOP = ".raybatch-"  # begins the folders' names; the process follows
# What whole files of a format end with
_ENDS = {".png": b"IEND\xae\x42\x60\x82", ".jpg": b"\xff\xd9", ".jpeg": b"\xff\xd9"}
_PROBE_BYTES = 1 << 16


class Workshop:
    """A folder beside the results, where Blender may leave half-written files; gone at the end."""

    def __init__(self, where: Path) -> None:
        self._where = where

    def __enter__(self) -> Workshop:
        _remove_workshops(self._where)
        self.folder = Path(tempfile.mkdtemp(prefix=f"{_WORKSHOP}{os.getpid()}-", dir=self._where))
        return self

    def __exit__(self, *_) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)

    @property
    def is_empty(self) -> bool:
        """Whether Blender wrote nothing."""
        return not any(self.folder.iterdir())

    def deliver(self, place: Path | None, name: str = "") -> None:
        """Move what Blender wrote to its place, where it bears the name of `place`; the views of stereoscopy add theirs
        to it. In the workshop that name is `name` and the frame's number. Without `place` files keep their names.
        """
        made = sorted(self.folder.iterdir())
        if not made:
            raise OutputError(f"Blender wrote no picture to {place or self._where}; is the disk full?")
        for file in made:
            self._check_whole(file, place)
        for file in made:
            target = self._where / file.name
            if place is not None:
                view = file.stem.removeprefix(name).lstrip("-0123456789") if len(made) > 1 else ""
                base = place.name.removesuffix(file.suffix) if view else ""
                target = place.with_name(f"{base}{view}{file.suffix}") if view else place
            os.replace(file, target)
            print_saved(target)

    def clear(self) -> None:
        """Remove what Blender wrote, which nobody wants."""
        for file in self.folder.iterdir():
            file.unlink()

    def _check_whole(self, file: Path, place: Path | None) -> None:
        """Raise `OutputError` where Blender wrote a part of `file` alone: it does not always say so."""
        end = _ENDS.get(file.suffix.lower(), b"")
        with open(file, "rb") as written:
            size = written.seek(0, os.SEEK_END)
            written.seek(max(0, size - len(end)))
            is_whole = size > 0 and (not end or written.read() == end)
        if is_whole and not end:  # of a format whose end is not known: a disk that was full still is
            try:
                with tempfile.TemporaryFile(dir=self.folder) as probe:
                    probe.write(bytes(_PROBE_BYTES))
            except OSError:
                is_whole = False
        if not is_whole:
            raise OutputError(f"{place or self._where / file.name} was not written whole; is the disk full?")


def _remove_workshops(where: Path) -> None:
    """Remove what processes left that were killed; where the system cannot tell whether one is alive, it stays."""
    for folder in where.glob(f"{_WORKSHOP}*-*"):
        process = folder.name.removeprefix(_WORKSHOP).partition("-")[0]
        if process.isdecimal() and os.name == "posix":
            try:
                os.kill(int(process), 0)  # sends nothing
            except ProcessLookupError:
                shutil.rmtree(folder, ignore_errors=True)
            except OSError:  # it is another user's
                continue
