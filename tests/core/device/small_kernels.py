"""Kernels that are compiled in no time, each of its own module, and what becomes of them."""

from __future__ import annotations

import itertools
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.devices import load_module, start_warp
from raybatch_addon.core.device.kept_kernels import KernelFiles, files_in, folders
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS

ROOT = Path(__file__).resolve().parents[3]
_numbers = itertools.count(1)


def keep_in(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels are kept in `folder`, which has none, but Warp's header: to parse it takes three seconds."""
    put_header(folder)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(folder))


def put_header(folder: Path) -> None:
    """Put Warp's header into `folder`, parsed as for the kernels of all tests."""
    start_warp()
    where = wp._src.context.runtime.get_clang_pch_dir()
    if where is None:  # there is no compiler for the CPU
        return
    parsed = Path(where)
    (folder / parsed.name).mkdir(parents=True)
    for path in parsed.glob("*.pch"):
        shutil.copy(path, folder / parsed.name)


def small_kernel(number: float | None = None) -> wp.Kernel:
    """A kernel that adds `number`; without one, a kernel that no other test has."""
    number = float(next(_numbers) if number is None else number)

    @wp.kernel(**KERNEL_OPTIONS)
    def add_number(values: wp.array(dtype=float)):
        values[wp.tid()] += wp.static(number)

    add_number.number = number
    return add_number


def forget(kernel: wp.Kernel) -> None:
    """Let the next launch of `kernel` load it again."""
    kernel.module.unload()


def works(kernel: wp.Kernel) -> bool:
    """Whether a launch of `kernel` does what it should."""
    values = wp.zeros(5, dtype=float, device="cpu")
    load_module(kernel, wp.get_device("cpu"))
    wp.launch(kernel, 5, [values], device="cpu")
    return bool((values.numpy() == np.float32(kernel.number)).all())


def files_of(kernel: wp.Kernel, folder: Path | None = None) -> KernelFiles:
    """Where `kernel` is kept."""
    return files_in(folder or folders()[0], kernel.module, wp.get_device("cpu"), 1)


# A process that loads two kernels into the folder sys.argv[1], and says what became of them
PROCESS = """
import sys
from pathlib import Path
sys.path[:0] = sys.argv[2:]
from raybatch_addon.core.device.devices import start_warp
from raybatch_addon.core.device.notes import take_notes
from raybatch_addon.core.errors import RayBatchError
from tests.core.device.small_kernels import small_kernel, works
try:
    start_warp(sys.argv[1])
    assert works(small_kernel(1001)) and works(small_kernel(1002))
    print("works")
except RayBatchError as error:
    print("error:", error)
for note in take_notes():
    print("note:", note)
"""


def process_command(folder: Path) -> list[str]:
    """A command that loads two kernels into `folder`."""
    return [sys.executable, "-c", PROCESS, str(folder), str(ROOT)]


def in_small_disk(command: list[str], folder: Path, options: str, then: str = "true") -> subprocess.CompletedProcess:
    """Run `command` where `folder` is a file system of its own, mounted with `options`; skips where none can be."""
    script = f'mount -t tmpfs -o {options} none "$0" && {then} && exec "$@"'
    if subprocess.run(["unshare", "-rm", "sh", "-c", script, str(folder), "true"], capture_output=True).returncode:
        pytest.skip("file systems cannot be mounted here")
    return subprocess.run(
        ["unshare", "-rm", "sh", "-c", script, str(folder), *command], capture_output=True, text=True, timeout=300
    )
