"""Counts of batching: taken by tracers that let rays wait, reported in the statistics of a render."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

# Points of the occupancy over time that a report keeps at most
OCCUPANCY_POINTS = 256
# Totals that stand at the top of every render's statistics, 0 where nothing batches
TOP_LEVEL_TOTALS = (
    "treelet_visits",
    "rays_queued",
    "blocks_peak",
    "wait_max",
    "bytes_copied",
    "pages_loaded",
    "pages_evicted",
    "resident_peak",
)
# Totals whose mean over all rays is reported too
_MEANS = ("treelet_visits", "rays_queued", "bytes_copied")


@dataclass(kw_only=True)
class BatchingTotals:
    """Counts of one worker, or of several together."""

    rays: int = 0  # taken in
    finished: int = 0  # given back; the same number at the end, but for those of a tile that was given up
    treelet_visits: int = 0  # rays times treelets that they went through
    rays_queued: int = 0  # times a ray was put into a queue
    steps: int = 0  # of the scheduler
    blocks_peak: int = 0  # blocks in use at once at most
    block_count: int = 0  # blocks of the pool
    blocks_short: int = 0  # times the blocks ran out
    wait_max: int = 0  # longest wait of a ray [steps]
    rays_unbatched: int = 0  # rays that went on alone, too few for their treelet
    bytes_copied: int = 0  # of pages brought to the device
    pages_loaded: int = 0
    pages_evicted: int = 0
    resident_peak: int = 0  # bytes of geometry on the device at most
    # (seconds since the tracer was made, rays that wait)
    occupancy: list[tuple[float, int]] = field(default_factory=list)

    _HIGHEST = ("wait_max", "resident_peak")

    def merge(self, other: BatchingTotals) -> BatchingTotals:
        """Both together; `blocks_peak` is the sum of the workers' peaks."""
        merged = BatchingTotals()
        for each in fields(self):
            mine, theirs = getattr(self, each.name), getattr(other, each.name)
            if each.name == "occupancy":
                merged.occupancy = max(mine, theirs, key=len)
            else:
                setattr(merged, each.name, max(mine, theirs) if each.name in self._HIGHEST else mine + theirs)
        return merged

    def note_occupancy(self, seconds: float, waiting: int) -> None:
        """`waiting` rays wait now; every other point is forgotten when there are too many."""
        self.occupancy.append((round(seconds, 6), waiting))
        if len(self.occupancy) > OCCUPANCY_POINTS:
            self.occupancy = self.occupancy[::2]

    def report(self) -> dict[str, Any]:
        """For the statistics (see docs/statistics.md): every count, and means over the finished rays."""
        counts = {each.name: getattr(self, each.name) for each in fields(self)}
        means = {f"{name}_per_ray": round(counts[name] / self.finished, 4) if self.finished else 0.0 for name in _MEANS}
        return {**counts, **means, "occupancy": [list(point) for point in self.occupancy]}


class PageWaits:
    """The longest wait of a ray for a page of geometry, found from counts by page at the end of each step."""

    def __init__(self, page_count: int):
        self.longest = 0  # [steps]
        self._waiting = np.zeros(page_count, bool)  # pages for which rays waited at the end of the last step
        self._since = np.zeros(page_count, np.int64)  # step in which the first of them came

    def note(self, step: int, counts: np.ndarray, served: np.ndarray) -> None:
        """At the end of `step` so many rays wait for each page. `served`: numbers of the pages whose rays were all
        taken in it, so that rays that wait for these came in this step.
        """
        went = self._waiting & (counts == 0)
        went[served] = self._waiting[served]
        if went.any():
            self.longest = max(self.longest, int((step - self._since[went]).max()))
        self._since[went | ~self._waiting] = step
        self._waiting = counts > 0

    def forget(self) -> None:
        """No ray waits any more."""
        self._waiting[:] = False


def batching_statistics(totals: BatchingTotals | None, auto: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """What batching adds to the statistics of a render (see docs/statistics.md).

    `totals` are those of all workers together; None where nothing batched. `auto` is what RayBatch chose, by the name
    of the setting that let it: `{"value": ..., "why": ...}`, each ready for JSON.
    """
    whole = totals or BatchingTotals()
    return {
        **{name: getattr(whole, name) for name in TOP_LEVEL_TOTALS},
        "batching": totals.report() if totals else None,
        "auto": auto,
    }
