"""Kernels are compiled once for all processes that run tests side by side, and what that takes is counted."""

from __future__ import annotations

import functools
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from raybatch_addon.core.files import sole_owner


@dataclass
class Builds:
    """What this process compiled."""

    count: int = 0
    own_seconds: float = 0.0  # of processors

    @property
    def seconds(self) -> float:
        """Seconds of processors, with compilers that run in processes of their own."""
        compiler = sys.modules.get("raybatch_addon.core.device.compiler")
        return self.own_seconds + (compiler.processor_seconds if compiler else 0.0)


BUILDS = Builds()
_counting = threading.Lock()


def build_once() -> None:
    """Make this process wait while another compiles the module that it needs, and then load what that one wrote.

    Warp looks for a compiled module, compiles it where there is none, and renames a folder in the end: processes that
    need the same at once each compile it.
    """
    import warp as wp
    from warp._src.context import Module

    build = Module._compile
    if getattr(build, "is_shared", False):
        return

    @functools.wraps(build)
    def built_by_one(module, *arguments, **options):
        with sole_owner(Path(wp.config.kernel_cache_dir) / ".building" / module.name):
            start = time.thread_time()
            is_new = build(module, *arguments, **options)
            if is_new:
                with _counting:
                    BUILDS.count += 1
                    BUILDS.own_seconds += time.thread_time() - start
            return is_new

    built_by_one.is_shared = True
    Module._compile = built_by_one
