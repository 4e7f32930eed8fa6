"""Clocks, and what is reported for several runs."""

from __future__ import annotations

import itertools
import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import warp as wp


def spread(values: Sequence[float]) -> float:
    """Largest less smallest, over the median."""
    middle = statistics.median(values)
    return (max(values) - min(values)) / middle if middle else 0.0


def summary(seconds: Sequence[float]) -> dict[str, Any]:
    """Median and spread of several runs."""
    return {"seconds": round(statistics.median(seconds), 4), "spread": round(spread(seconds), 3), "runs": len(seconds)}


def seconds_of(tasks: Sequence[Callable[[], object]], device: wp.Device, waits: bool = False) -> float:
    """Seconds that `tasks` take: on a CUDA device, one task by the device's own clock; on the CPU, each on a thread of
    its own.

    One CPU thread is timed by its own clock, which stands still while others have its core, unless it `waits` for what
    it needs; that one, and several, by the wall's.
    """
    if device.is_cuda:
        start, end = (wp.Event(device, enable_timing=True) for _ in range(2))
        with wp.ScopedDevice(device):
            wp.record_event(start)
            for task in tasks:
                task()
            wp.record_event(end)
        return wp.get_event_elapsed_time(start, end) / 1000
    if len(tasks) == 1:
        clock = time.perf_counter if waits else time.thread_time
        began = clock()
        tasks[0]()
        return clock() - began
    with ThreadPoolExecutor(len(tasks)) as pool:
        for waiting in [pool.submit(time.sleep, 0.001) for _ in tasks]:  # the threads themselves are not timed
            waiting.result()
        began = time.perf_counter()
        for running in [pool.submit(task) for task in tasks]:
            running.result()
        return time.perf_counter() - began


def slices(count: int, parts: int) -> list[slice]:
    """0 to `count` in up to `parts` parts of about the same size, none of them empty."""
    edges = [count * part // parts for part in range(parts + 1)]
    return [slice(first, end) for first, end in itertools.pairwise(edges) if end > first]
