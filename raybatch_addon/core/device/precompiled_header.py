"""Warp's header, parsed once for all threads and all processes.

Warp's CPU compiler reads a header of 1.8 seconds before the first kernel that a thread compiles, and keeps what it has
read for that thread alone; with it, a small kernel takes 0.1 seconds. Here it is kept in a folder beside the compiled
kernels, for whoever compiles next.

The compiler for CUDA, and the one for CPUs where that folder cannot be had, keep theirs as Warp does: in a temporary
folder for each thread, of 4.5 MB. A process that is killed leaves it there. So each folder has a file that its process
holds locked as long as it lives, and what nobody holds is removed at the next start.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import warp as wp

from ..files import OWNED_PREFIXES, give_up, owned_folder, remove_if_left
from .compiler import CompileError
from .kept_kernels import folders, spare_folder
from .kernel import MODULE_OPTIONS

_lock = threading.Lock()  # while one thread reads the header, others wait for it
_PREFIX = "wp_pch_"  # of Warp's temporary folders


def share_precompiled_header() -> None:
    """Let kernels be compiled for the CPU with a header that all share; called after `wp.init`.

    A Warp that keeps its header elsewhere is left as it is.
    """
    runtime = wp._src.context.runtime
    of_a_thread = getattr(runtime, "_get_or_create_pch_dir", None)
    if of_a_thread is not None and not getattr(of_a_thread, "is_owned", False):
        remove_left_folders()
        runtime._get_or_create_pch_dir = _OwnedFolders(of_a_thread)
    own_folder = getattr(runtime, "get_clang_pch_dir", None)
    if own_folder is None or runtime.llvm is None or getattr(own_folder, "is_shared", False):
        return

    def shared_folder() -> str:
        return _shared_folder(own_folder)

    shared_folder.is_shared = True
    runtime.get_clang_pch_dir = shared_folder


def _shared_folder(own_folder: Callable[[], str]) -> str:
    """The folder of the header, made where there is none; Warp's own for this thread where it cannot be."""
    header = Path(wp._src.build.warp_home) / "native" / "builtin.h"
    try:
        # another copy of Warp, or the same installed again, may not use it, nor a compiler that optimises otherwise
        level = wp.config.optimization_level
        own = f"{header} {header.stat().st_mtime_ns}{'' if level is None else f' {level}'}"
        key = hashlib.sha256(own.encode()).hexdigest()[:16]
        with _lock:
            found = [each for each in (folder / f"header-{key}" for folder in folders()) if any(each.glob("*.pch"))]
            return str(found[0] if found else _make(f"header-{key}"))
    except Exception:  # whatever it is, the compiler says it again of the kernel if it matters there
        return own_folder()


def _make(name: str) -> Path:
    """The folder `name`, with the header parsed in it."""
    folder = folders()[-1] / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _compile_nothing(folder)
        return folder
    except (OSError, CompileError) as error:
        shutil.rmtree(folder, ignore_errors=True)
        lack = error if isinstance(error, OSError) else error.lack_of_room
        if lack is None or (spare := spare_folder(folder.parent, lack)) == folder.parent:
            raise
        folder = spare / name
        folder.mkdir(parents=True, exist_ok=True)
        _compile_nothing(folder)
        return folder


def _compile_nothing(folder: Path) -> None:
    """Compile an empty file as kernels are compiled, which leaves the parsed header in `folder`."""
    level = wp.config.optimization_level
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        source = Path(scratch) / "nothing.cpp"
        source.write_text('#define WP_TILE_BLOCK_DIM 1\n#include "builtin.h"\n', encoding="utf-8")
        wp._src.build.build_cpu(
            str(source.with_suffix(".o")),
            str(source),
            fuse_fp=MODULE_OPTIONS["fuse_fp"],
            extra_flags=MODULE_OPTIONS["cpu_compiler_flags"],
            use_precompiled_headers=True,
            pch_dir=str(folder),
            block_dim=1,
            **({} if level is None else {"optimization_level": level}),
        )


class _OwnedFolders:
    """Temporary folders, one for each thread that asks, which this process holds and removes at its end."""

    is_owned = True

    def __init__(self, otherwise: Callable[[], str]):
        self._otherwise = otherwise  # where the file system has no locks
        self._folders: dict[int, str] = {}

    def __call__(self) -> str:
        thread = threading.get_ident()
        if thread not in self._folders:
            self._folders[thread] = self._make()
        return self._folders[thread]

    def _make(self) -> str:
        with contextlib.suppress(OSError):
            if owned := owned_folder(_PREFIX):
                atexit.register(give_up, *owned)
                return str(owned[0])
        return self._otherwise()


def remove_left_folders() -> None:
    """Remove the temporary folders that processes left which were killed, those of `OWNED_PREFIXES` too.

    Those of the header without a file for their owner are of Warp without RayBatch: they go where the system says that
    no process with Warp in it is as old.
    """
    with contextlib.suppress(OSError):  # the temporary folder cannot be read
        with os.scandir(tempfile.gettempdir()) as entries:
            found = [
                entry
                for entry in entries
                if entry.name.startswith((_PREFIX, *OWNED_PREFIXES)) and entry.is_dir(follow_symlinks=False)
            ]
        users = None
        for entry in found:
            with contextlib.suppress(OSError):  # of another user, or another process removes it
                if remove_if_left(entry.path):
                    continue
                if entry.name.startswith(_PREFIX) and _is_own(entry):
                    users = [*_processes_with_warp()] if users is None else users
                    if all(began > entry.stat().st_mtime for began in users):
                        shutil.rmtree(entry.path, ignore_errors=True)


def _is_own(entry: os.DirEntry) -> bool:
    """Whether this user made the folder: the processes of others are not looked at."""
    return not hasattr(os, "getuid") or entry.stat().st_uid == os.getuid()


def _processes_with_warp() -> Iterator[float]:
    """When each process began that has Warp's libraries in it, or of which that is not known [s since 1970]."""
    if not sys.platform.startswith("linux"):
        yield 0.0
        return
    booted = time.time() - float(Path("/proc/uptime").read_text().split()[0])
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if process.stat().st_uid != os.getuid():
                continue
            if process.name != str(os.getpid()) and "/warp" not in (process / "maps").read_text(errors="replace"):
                continue
            ticks = int((process / "stat").read_text(errors="replace").rpartition(")")[2].split()[19])
            yield booted + ticks / os.sysconf("SC_CLK_TCK") - 1.0
        except PermissionError:
            yield 0.0
        except (OSError, ValueError, IndexError):  # it ended meanwhile
            continue
