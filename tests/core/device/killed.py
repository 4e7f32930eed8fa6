"""Processes that hold a temporary folder and are killed, and the next start of RayBatch."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]


def environment_with(temporary):
    """Variables of a process that imports RayBatch, and has its temporary folders in `temporary`."""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    return os.environ | {"PYTHONPATH": path, "TMPDIR": str(temporary), "TEMP": str(temporary), "TMP": str(temporary)}


@contextlib.contextmanager
def holding(code, temporary, *arguments):
    """A process that runs `code`, which prints a line on a path below `temporary` and waits for one; and that path."""
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        env=environment_with(temporary),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with process:
        try:
            yield process, _held_path(process.stdout, temporary)
        finally:
            process.kill()


def _held_path(lines, temporary):
    """The first line that is a path below `temporary`: Blender may have printed others before."""
    for line in lines:
        path = Path(line.strip())
        if path.is_relative_to(temporary):
            return path
    raise AssertionError("the process ended before it held a folder")


def start_another(temporary):
    """Start RayBatch's device in another process, which ends."""
    code = "from raybatch_addon.core.device.devices import start_warp; start_warp()"
    subprocess.run([sys.executable, "-c", code], env=environment_with(temporary), check=True)


def check_it_goes_at_the_next_start(process, folder, temporary):
    """`folder` in `temporary` stays as long as `process` lives, and is removed by the next start after a kill."""
    kept = sorted(folder.iterdir())
    start_another(temporary)
    assert kept and sorted(folder.iterdir()) == kept, "its process lives"
    process.kill()
    process.wait()
    assert folder.exists()
    start_another(temporary)
    assert not folder.exists()
