"""The project's scripts, run in this process: as in one of their own, but for the seconds that it takes to start."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from unittest import mock


def call_script(name: str, *arguments: object, **environment: object) -> subprocess.CompletedProcess:
    """What `run_script` returns, of the `main` of scripts/`name`, called here with `environment` besides what there is.

    The add-on is registered afterwards if it was before. Blender has the file open that the script opened.
    """
    script = importlib.import_module(Path(name).stem)
    command = [*map(str, arguments)]
    variables = {variable: str(value) for variable, value in environment.items()}
    with mock.patch.dict(os.environ, variables), _addon_as_before(), _captured() as written:
        try:
            code = script.main(command)
        except SystemExit as end:  # of argparse
            code = end.code or 0
    return subprocess.CompletedProcess([name, *command], code, *written)


@contextlib.contextmanager
def _addon_as_before() -> Iterator[None]:
    """Inside, the add-on is not registered, as in a new process; listeners that are added go at the end."""
    if "bpy" not in sys.modules:
        yield
        return
    import bpy

    import raybatch_addon
    from raybatch_addon.blender import frame

    def registered() -> bool:
        return hasattr(bpy.types.Scene, "raybatch")

    lists = (
        frame.film_listeners,
        frame.scene_listeners,
        frame.progress_listeners,
        frame.note_listeners,
        frame.stop_listeners,
    )
    was_registered, listeners = registered(), [list(each) for each in lists]
    if was_registered:
        raybatch_addon.unregister()
    try:
        yield
    finally:
        for each, before in zip(lists, listeners, strict=True):
            each[:] = before
        if registered():
            raybatch_addon.unregister()
        if was_registered:
            raybatch_addon.register()


@contextlib.contextmanager
def _captured() -> Iterator[list[str]]:
    """Yield a list that holds, at the end, what was written to standard output and to standard error."""
    written: list[str] = []
    flush_native = ctypes.CDLL(None).fflush
    flush_native(None)
    with contextlib.ExitStack() as opened:
        files = [opened.enter_context(tempfile.TemporaryFile()) for _ in (1, 2)]
        real = []
        for stream, descriptor, file in zip((sys.stdout, sys.stderr), (1, 2), files, strict=True):
            stream.flush()
            real.append(os.dup(descriptor))
            os.dup2(file.fileno(), descriptor)
        texts = [opened.enter_context(os.fdopen(os.dup(each), "w", encoding="utf-8")) for each in (1, 2)]
        try:
            with contextlib.redirect_stdout(texts[0]), contextlib.redirect_stderr(texts[1]):
                yield written
        finally:
            for text, descriptor, before, file in zip(texts, (1, 2), real, files, strict=True):
                text.flush()
                os.dup2(before, descriptor)
                os.close(before)
                file.seek(0)
                written.append(file.read().decode("utf-8"))
            flush_native(None)  # what Blender's own code wrote, and a process would keep for itself as it ends
