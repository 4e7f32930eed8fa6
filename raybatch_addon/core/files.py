"""Files that are written whole or not at all, and files that one process at a time may change."""

from __future__ import annotations

import contextlib
import itertools
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

OWNER = "owner"  # the file in a temporary folder that its process holds locked as long as it lives
# What names of such folders begin with, by what is in them
KERNELS_PREFIX, VOLUMES_PREFIX = "raybatch-kernels-", "raybatch-volumes-"
OWNED_PREFIXES = (KERNELS_PREFIX, VOLUMES_PREFIX)
_numbers = itertools.count()


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A path beside `path` to write to: when the block ends that file becomes `path`, when it fails nothing is left.

    Errors of the file system (`OSError`) are raised as they are. The name ends as that of `path`, for writers that look
    at it, and no other thread or process gets the same one.
    """
    temporary = path.with_name(f".{os.getpid()}.{next(_numbers)}.{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        with contextlib.suppress(OSError):  # it became `path`, or was never made
            temporary.unlink()


@contextlib.contextmanager
def sole_owner(path: Path) -> Iterator[None]:
    """Inside, this thread alone of all threads of all processes holds `path`, a file that is made and stays.

    Where the file system has no locks, nobody waits. Errors of the file system are raised where `path` cannot be made.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle = os.open(path, os.O_CREAT | os.O_RDWR)  # a lock belongs to the open file: threads exclude each other too
    try:
        with contextlib.suppress(OSError):
            _lock(handle, waits=True)
        yield
    finally:
        os.close(handle)  # which gives the lock back; the system does too where a process is killed


def _lock(handle: int, waits: bool) -> None:
    """Lock the open file `handle`; raises `OSError` where another holds it and this one does not wait (on Windows,
    after ten seconds), or where the file system has no locks.
    """
    if sys.platform == "win32":
        msvcrt.locking(handle, msvcrt.LK_LOCK if waits else msvcrt.LK_NBLCK, 1)
    else:
        fcntl.flock(handle, fcntl.LOCK_EX if waits else fcntl.LOCK_EX | fcntl.LOCK_NB)


def owned_folder(prefix: str) -> tuple[Path, int] | None:
    """A new temporary folder, whose name begins with `prefix`, and the handle of its file `OWNER`, which this process
    holds until `give_up` or its end; None where the file system has no locks. Raises `OSError`.
    """
    # under another name until it is held, so that nobody takes it for one that was left
    folder = Path(tempfile.mkdtemp(prefix=prefix if sys.platform == "win32" else f"new-{prefix}"))
    try:
        handle = lock_now(folder / OWNER)
        if handle is None:
            shutil.rmtree(folder, ignore_errors=True)
            return None
        if sys.platform != "win32":
            folder = folder.rename(folder.with_name(folder.name.removeprefix("new-")))
    except OSError:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder, handle


@contextlib.contextmanager
def temporary_folder(prefix: str) -> Iterator[Path]:
    """A new temporary folder for the time of the block, whose name begins with `prefix`, one of `OWNED_PREFIXES`: where
    the process is killed meanwhile, the next one that starts Warp removes it. Raises `OSError`.
    """
    owned = owned_folder(prefix)
    if owned is None:
        with tempfile.TemporaryDirectory(prefix=prefix) as folder:
            yield Path(folder)
        return
    try:
        yield owned[0]
    finally:
        give_up(*owned)


def remove_if_left(folder: Path | str) -> bool:
    """Remove `folder` where its process ended without doing so; returns whether it is a folder that a process holds, or
    held, at all. Raises `OSError`, as where it is another user's.
    """
    owner = Path(folder) / OWNER
    if not owner.exists():
        return False
    handle = lock_now(owner)
    if handle is not None:
        give_up(folder, handle)
    return True


def give_up(folder: Path | str, handle: int) -> None:
    """Remove a folder that this process holds by `handle`."""
    if sys.platform == "win32":  # an open file cannot be removed
        os.close(handle)
    shutil.rmtree(folder, ignore_errors=True)
    if sys.platform != "win32":
        os.close(handle)


def lock_now(path: Path) -> int | None:
    """The open file `path`, which this process holds until it closes it or ends; None where another holds it already,
    or where the file system has no locks.

    It is made where it is not there; errors of that (`OSError`) are raised.
    """
    handle = os.open(path, os.O_CREAT | os.O_RDWR)
    try:
        _lock(handle, waits=False)
    except OSError:
        os.close(handle)
        return None
    return handle
