"""Warp's header, parsed once for all threads and all processes.

Warp's CPU compiler reads a header of 1.8 seconds before the first kernel that a thread compiles, and keeps what it has
read for that thread alone; with it, a small kernel takes 0.1 seconds. Here it is kept in a folder beside the compiled
kernels, for whoever compiles next.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

import warp as wp

from .compiler import CompileError
from .kept_kernels import folders, spare_folder
from .kernel import MODULE_OPTIONS

_lock = threading.Lock()  # while one thread reads the header, others wait for it


def share_precompiled_header() -> None:
    """Let kernels be compiled for the CPU with a header that all share; called after `wp.init`.

    A Warp that keeps its header elsewhere is left as it is.
    """
    runtime = wp._src.context.runtime
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
        # another copy of Warp, or the same installed again, may not use it
        key = hashlib.sha256(f"{header} {header.stat().st_mtime_ns}".encode()).hexdigest()[:16]
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
        )
