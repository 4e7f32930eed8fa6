"""Work on a file in a process of its own, which is ended when a step takes too long: a crash or a render that hangs
costs no other file.
"""

from __future__ import annotations

import compileall
import contextlib
import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from raybatch_addon.blender.kernel_cache import VARIABLE
from real_files.code import addon_folder
from real_files.judging import NAMES
from real_files.worker import STATE

DONE, FAILED, CRASHED, TIMED_OUT = "done", "failed", "crashed", "timed out"
COLD = "cold"  # for --kernel-cache: an empty one
LOOK_SECONDS = 0.1  # between looks at how far the process is
LINES_KEPT = 3  # of what a process said last


@dataclass
class ProcessOutcome:
    """The result of a process."""

    status: str
    state: dict[str, Any] = field(default_factory=dict)  # as `worker.Steps` wrote it
    error: str = ""
    pictures: dict[str, np.ndarray] = field(default_factory=dict)

    def data(self) -> dict[str, Any]:
        """The values as JSON holds them, without pictures."""
        return {"status": self.status, "error": self.error, **self.state}


def run_process(script: Path, request: dict[str, Any], limit: float, kernel_cache: str | None) -> ProcessOutcome:
    """Let `script --worker` do what `request` says, each step within `limit` seconds.

    `kernel_cache` is the folder of compiled kernels that a copy is made of, `COLD` for an empty one, None to use the
    user's own.
    """
    with tempfile.TemporaryDirectory(prefix="raybatch-compare-") as scratch:
        folder = Path(scratch) / "work"
        folder.mkdir()
        (folder / "request.json").write_text(json.dumps(request), encoding="utf-8")
        environment = _as_blender_begins()
        if kernel_cache is not None and request["engine"] != "CYCLES":
            kernels = Path(scratch) / "kernels"
            if kernel_cache == COLD:
                kernels.mkdir()
            else:
                shutil.copytree(kernel_cache, kernels)
            environment |= {VARIABLE: str(kernels), "WARP_CACHE_PATH": str(kernels)}
        command = [sys.executable, str(script), "--worker", str(folder / "request.json")]
        said = folder / "said.txt"
        with open(said, "wb") as sink:
            process = subprocess.Popen(
                command,
                stdout=sink,
                stderr=subprocess.STDOUT,
                stdin=subprocess.PIPE,  # never written to: at its end the worker knows that nobody waits any more
                env=environment,
                start_new_session=True,
            )
            try:
                in_time = _watch(process, folder, limit)
            finally:
                _end(process)
        return _outcome(process.returncode, in_time, folder, said, request, limit)


@functools.cache
def _bytecode(addon: Path) -> None:
    """Blender keeps the bytecode of add-ons from the first time that it reads them."""
    compileall.compile_dir(addon, quiet=2)


def _as_blender_begins() -> dict[str, str]:
    """The environment of a process in which an engine is as Blender has it: Blender takes none of Python's variables,
    of which one would let each process read the sources of the add-on anew, for half a second.
    """
    _bytecode(addon_folder())
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def _watch(process: subprocess.Popen, folder: Path, limit: float) -> bool:
    """Wait for the end of the process; False if a step took more than `limit` seconds."""
    seen, since = 0, time.monotonic()
    while process.poll() is None:
        changed = (folder / STATE).stat().st_mtime_ns if (folder / STATE).exists() else 0
        if changed != seen:
            seen, since = changed, time.monotonic()
        if time.monotonic() - since > limit:
            return False
        time.sleep(LOOK_SECONDS)
    return True


def _end(process: subprocess.Popen) -> None:
    """End the process, and those that it started."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _outcome(code: int, in_time: bool, folder: Path, said: Path, request: dict, limit: float) -> ProcessOutcome:
    state = json.loads((folder / STATE).read_text(encoding="utf-8")) if (folder / STATE).exists() else {}
    error, doing = state.pop("error", ""), state.pop("doing", "starting Blender")
    pictures = {
        each["name"]: np.load(folder / f"{each['name']}.npy")
        for each in state.get("steps", [])
        if (folder / f"{each['name']}.npy").exists()
    }
    made: dict[str, Any] = {"state": state, "pictures": pictures}
    name = NAMES.get(request["engine"], request["engine"])
    if not in_time:
        text = (
            f"{name} was ended in the step “{doing}”, which took more than {limit:g} s: raise --limit, or lower "
            "--width or --samples"
        )
        return ProcessOutcome(TIMED_OUT, error=text, **made)
    if error:
        return ProcessOutcome(FAILED, error=error, **made)
    if code:
        lines = [line.strip() for line in said.read_text(errors="replace").splitlines() if line.strip()]
        how = f"signal {-code} ({signal.Signals(-code).name})" if code < 0 else f"exit code {code}"
        last = " / ".join(lines[-LINES_KEPT:]) or "nothing"
        text = (
            f"Blender's process ended with {how} in the step “{doing}” of {name}; it said last: {last}. Try the file "
            "in Blender itself: if that crashes too, delete what crashes it (often a fluid or a cache) in a copy"
        )
        return ProcessOutcome(CRASHED, error=text, **made)
    return ProcessOutcome(DONE, **made)
