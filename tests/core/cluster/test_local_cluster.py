"""How a cluster of this machine's own starts."""

import contextlib
import os
import signal
import threading
import time

import psutil
import pytest

pytest.importorskip("distributed")

from raybatch_addon.core.cluster.connection import ClusterError
from raybatch_addon.core.cluster.local import local_cluster


def kill_first_worker(over, killed):
    before = {each.pid for each in psutil.Process().children(recursive=True)}
    while not over.is_set():
        for process in psutil.Process().children(recursive=True):
            with contextlib.suppress(psutil.Error):
                if process.pid not in before and "spawn_main" in " ".join(process.cmdline()):
                    process.send_signal(signal.SIGKILL)
                    killed.append(process.pid)
                    return
        time.sleep(0.02)


def test_a_worker_that_ends_while_it_starts_is_an_error_in_one_line():
    over, killed = threading.Event(), []
    killer = threading.Thread(target=kill_first_worker, args=(over, killed))
    killer.start()
    try:
        with (
            pytest.raises(ClusterError, match="the local cluster did not start .*; try again$") as raised,
            local_cluster(1, os.environ.get("RAYBATCH_KERNEL_CACHE")),
        ):
            pass
        assert killed and "\n" not in str(raised.value)
    finally:
        over.set()
        killer.join()


def test_an_error_of_who_renders_on_it_is_its_own():
    with pytest.raises(RuntimeError, match="^mine$"), local_cluster(1, os.environ.get("RAYBATCH_KERNEL_CACHE")):
        raise RuntimeError("mine")
