"""Loaded into each worker of these clusters (Dask's `--preload`): what a worker does to itself when it is signalled.

SIGUSR1: what it returns next of a render or a merge is damaged, after its digest was made. SIGUSR2: all its connections
end.
"""

from __future__ import annotations

import functools
import os
import random
import signal
from pathlib import Path
from typing import Any

# Environment variable: a file that gets a line for each result that was damaged
DAMAGED = "RAYBATCH_TEST_DAMAGED"


class _Damage:
    """Flips one bit of a result, once it was asked to."""

    def __init__(self) -> None:
        self._random, self.is_wanted = random.Random(), False

    def of(self, function: Any) -> Any:
        """`function` whose results may be damaged."""

        @functools.wraps(function)
        def damaging(*arguments: Any) -> Any:
            sent = function(*arguments)
            if self.is_wanted and "halves" in sent:
                self.is_wanted = False
                self._flip(sent)
                with Path(os.environ[DAMAGED]).open("a") as file:
                    file.write(f"{function.__name__}\n")
            return sent

        return damaging

    def _flip(self, sent: dict[str, Any]) -> None:
        half = self._random.choice(sent["halves"])
        name = self._random.choice(sorted(name for name, array in half.items() if array.nbytes))
        array = half[name].copy()
        array.reshape(-1).view("uint8")[self._random.randrange(array.nbytes)] ^= 1 << self._random.randrange(8)
        half[name] = array


def dask_setup(worker: Any) -> None:
    """Called by Dask when a worker starts, on its event loop."""
    from raybatch_addon.core.cluster import work

    damage = _Damage()
    for name in ("render", "merge"):
        setattr(work, name, damage.of(getattr(work, name)))
    loop = worker.loop.asyncio_loop
    loop.add_signal_handler(signal.SIGUSR1, lambda: setattr(damage, "is_wanted", True))
    loop.add_signal_handler(signal.SIGUSR2, lambda: _cut(worker))


def _cut(worker: Any) -> None:
    """End the connections of `worker` as a cable does that is pulled: nobody says goodbye."""
    for comm in [*worker._comms, worker.batched_stream.comm]:
        comm.abort()
