"""Loaded into each worker of these clusters (Dask's `--preload`): what a worker does to itself when it is told to.

Where its folder of faults has a file `DAMAGE`, what it returns next of a render or a merge is damaged, after its digest
was made. SIGUSR2: all its connections end. It notes when it did either. Where the folder has a file `FULL`, nothing can
be written to files.
"""

from __future__ import annotations

import contextlib
import functools
import os
import random
import resource
import signal
import time
from pathlib import Path
from typing import Any

# Environment variable: the folder of the machine's faults
FAULTS = "RAYBATCH_TEST_FAULTS"
DAMAGE, FULL = "damage next", "full"  # files in it: what is to be done
DAMAGED, CUT = "damaged", "cut"  # what was done


def note(kind: str) -> None:
    """Note that a fault is done now: in the name of an empty file, which is made where a disk is full too."""
    (Path(os.environ[FAULTS]) / f"{time.monotonic_ns()} {kind}").touch()


def noted(folder: Path, kind: str) -> list[float]:
    """When it was, by the clock of `time.monotonic` [s], which all processes share."""
    return sorted(int(each.name.split()[0]) / 1e9 for each in folder.glob(f"* {kind}") if each.name[0].isdigit())


def fill_disk(pid: int, is_full: bool) -> None:
    """Whatever the process `pid` (0: this one) writes to files fails, or no longer does."""
    _, most = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (0 if is_full else most, most))


class _Damage:
    """Flips one bit of a result, once it was asked to."""

    def __init__(self) -> None:
        self._random = random.Random()

    def of(self, function: Any) -> Any:
        """`function` whose results may be damaged."""

        @functools.wraps(function)
        def damaging(*arguments: Any) -> Any:
            sent = function(*arguments)
            if "halves" in sent and _is_taken(DAMAGE):
                self._flip(sent)
                note(DAMAGED)
            return sent

        return damaging

    def _flip(self, sent: dict[str, Any]) -> None:
        half = self._random.choice(sent["halves"])
        name = self._random.choice(sorted(name for name, array in half.items() if array.nbytes))
        array = half[name].copy()
        array.reshape(-1).view("uint8")[self._random.randrange(array.nbytes)] ^= 1 << self._random.randrange(8)
        half[name] = array


def _is_taken(name: str) -> bool:
    """Whether the file `name` was there; it is no longer."""
    with contextlib.suppress(OSError):
        (Path(os.environ[FAULTS]) / name).unlink()
        return True
    return False


def dask_setup(worker: Any) -> None:
    """Called by Dask when a worker starts, on its event loop."""
    from raybatch_addon.core.cluster import work

    damage = _Damage()
    for name in ("render", "merge"):
        setattr(work, name, damage.of(getattr(work, name)))
    worker.loop.asyncio_loop.add_signal_handler(signal.SIGUSR2, lambda: _cut(worker))
    fill_disk(0, (Path(os.environ[FAULTS]) / FULL).exists())


def _cut(worker: Any) -> None:
    """End the connections of `worker` as a cable does that is pulled: nobody says goodbye."""
    for comm in [*worker._comms, worker.batched_stream.comm]:
        comm.abort()
    note(CUT)
