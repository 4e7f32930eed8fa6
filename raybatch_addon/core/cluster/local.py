"""A cluster of this machine's own: a scheduler, and workers that share its processors or have a GPU each."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import threading
from collections.abc import Iterator
from typing import Any

import warp as wp

from ..device.devices import start_warp, warp_cache_folder, worker_count
from .connection import PACKAGES, RESOURCE, ClusterError
from .work import KERNEL_CACHE, WORKER_DEVICE, WORKER_THREADS

# A worker that is gone for so long is replaced by another, in vain: its nanny starts it again, on a busy machine after
# many seconds, and one that cannot is taken out by `_watch`. Else there would be one too many, and Dask would end it
_REPLACED_AFTER = "60 s"
# Dask looks after itself less often than it would on machines of its own: here that takes time from the samples. As it
# is, scheduler, nannies and two workers take an eighth of a core while nothing is asked of them, and so a fortieth
_DASK = {
    "distributed.deploy.lost-worker-timeout": _REPLACED_AFTER,
    "distributed.admin.tick.interval": "500 ms",  # of a clock that tells whether an event loop is late
    "distributed.admin.system-monitor.interval": "5 s",  # processors and memory, for the dashboard
    "distributed.worker.memory.monitor-interval": "5 s",  # workers have no limit of memory
    "distributed.worker.profile.enabled": False,  # where its functions take time, for the dashboard
    "distributed.scheduler.work-stealing": False,  # each has one task
}


@contextlib.contextmanager
def local_cluster(count: int, kernel_cache: str | None = None) -> Iterator[str]:
    """The address of a scheduler with `count` workers here, which end with it; raises `ClusterError`.

    Where there are CUDA devices, workers take them in turn; else each has its part of the processors.
    """
    try:
        import dask
        import distributed
    except ImportError as error:
        raise ClusterError(f"Dask is not installed ({error}): {PACKAGES}") from None
    if count < 1:
        raise ClusterError(f"local:{count}: name one worker or more")
    start_warp(kernel_cache)
    cuda = [each.alias for each in wp.get_cuda_devices()]
    threads = max(worker_count(wp.get_device("cpu"), 0) // count, 1)
    folder = kernel_cache or os.environ.get(KERNEL_CACHE) or str(warp_cache_folder())

    def worker(i: int) -> dict[str, Any]:
        device = cuda[i % len(cuda)] if cuda else "cpu"
        return {
            "cls": distributed.Nanny,
            "options": {
                "nthreads": 2,  # films are merged while the next range is rendered
                "resources": {RESOURCE: 1},
                "env": {WORKER_DEVICE: device, WORKER_THREADS: str(0 if cuda else threads), KERNEL_CACHE: folder},
                "memory_limit": 0,  # a scene takes what it takes
                "dashboard": False,
                "silence_logs": logging.ERROR,
            },
        }

    class Cluster(distributed.SpecCluster):
        def new_worker_spec(self) -> dict[int, dict[str, Any]]:
            """Of one that takes the place of one that is gone."""
            free = next(i for i in itertools.count() if i not in self.worker_spec)
            return {free: worker(free)}

    options = {"dashboard": False, "dashboard_address": ":0", "host": "127.0.0.1"}
    scheduler = {"cls": distributed.Scheduler, "options": options}
    workers = {i: worker(i) for i in range(count)}
    with dask.config.set(_DASK), contextlib.ExitStack() as stack:
        try:  # the start alone: errors of who renders on it are their own
            cluster = stack.enter_context(Cluster(workers=workers, scheduler=scheduler, silence_logs=logging.ERROR))
        except (RuntimeError, TimeoutError, OSError) as error:
            why = " ".join(str(error).split()) or type(error).__name__
            raise ClusterError(
                f"the local cluster did not start ({why}): a worker ended while it started, or took too long, perhaps "
                f"for want of memory; try again{', or with fewer workers' if count > 1 else ''}"
            ) from error
        cluster.adapt(minimum=count, maximum=count, interval="1 s")
        over = threading.Event()
        watch = threading.Thread(target=_watch, args=(cluster, over), daemon=True)
        watch.start()
        try:
            yield cluster.scheduler_address
        finally:
            over.set()
            watch.join()


def _watch(cluster: Any, over: threading.Event) -> None:
    """Take out who could not start its worker again: Dask puts another in its place."""

    async def take_out() -> None:
        for name, nanny in [*cluster.workers.items()]:
            if str(nanny.status.name) in ("closed", "failed"):
                cluster.workers.pop(name, None)
                cluster.worker_spec.pop(name, None)

    while not over.wait(1.0):
        with contextlib.suppress(Exception):  # it ends
            cluster.sync(take_out)
