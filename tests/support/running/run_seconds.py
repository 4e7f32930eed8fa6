"""A plugin of pytest: what a run took, in seconds of processors, and how much of that went into compiling kernels.

Seconds of processors hardly change with what else the machine does. With --store-seconds the seconds of each file are
kept in file_seconds.json.
"""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

from tests.support.running.file_seconds import store
from tests.support.running.kernel_builds import BUILDS

KEY = "processor_seconds"


def pytest_addoption(parser):
    parser.addoption("--store-seconds", action="store_true", help="keep what each file of tests took")


def processor_seconds() -> dict[str, float]:
    """Of this process, of the processes that it started and waited for, and of compiling here."""
    times = os.times()
    return {
        "here": times.user + times.system,
        "processes": times.children_user + times.children_system,
        "compiling": BUILDS.seconds,
        "kernels": BUILDS.count,
    }


class RunSeconds:
    """Gathers from all workers."""

    def __init__(self, config):
        self.config = config
        self.workers: list[dict[str, float]] = []
        self.files: Counter = Counter()

    def pytest_sessionfinish(self, session):
        output = getattr(self.config, "workeroutput", None)
        if output is not None:
            output[KEY] = processor_seconds()

    def pytest_testnodedown(self, node, error):
        self.workers.append(getattr(node, "workeroutput", {}).get(KEY, {}))

    def pytest_runtest_logreport(self, report):
        self.files[Path(report.nodeid.partition("::")[0]).name] += report.duration

    def pytest_terminal_summary(self, terminalreporter):
        own = processor_seconds()
        if self.workers:  # which are this process's own, waited for or not
            own["processes"] = 0.0
        total: Counter = Counter(own)
        for worker in self.workers:
            total.update(worker)
        spent = total["here"] + total["processes"]
        terminalreporter.write_line(
            f"{spent:.0f} seconds of processors, {total['processes']:.0f} of them in scripts; "
            f"{total['kernels']:.0f} kernels were compiled in {total['compiling']:.0f}"
        )
        if self.config.option.store_seconds:
            store(dict(self.files))


def pytest_configure(config):
    config.pluginmanager.register(RunSeconds(config), "run_seconds_gatherer")
