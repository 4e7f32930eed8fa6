"""A plugin of pytest: what a run took, in seconds of processors, and how much of that went into compiling kernels.

Seconds of processors hardly change with what else the machine does. With --store-seconds those of each file are kept
in file_seconds.json, and the files that took most are listed.
"""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import pytest

from tests.support.running.file_seconds import store
from tests.support.running.kernel_builds import BUILDS

KEY = "processor_seconds"
LISTED = 40  # files, with --store-seconds


def pytest_addoption(parser):
    parser.addoption("--store-seconds", action="store_true", help="keep what each file of tests took")


def processor_seconds() -> dict[str, float]:
    """Seconds of this process, of the processes that it started and waited for, and of compiling here."""
    times = os.times()
    return {
        "here": times.user + times.system,
        "processes": times.children_user + times.children_system,
        "compiling": BUILDS.seconds,
        "kernels": BUILDS.count,
    }


def _spent() -> tuple[float, float]:
    """Seconds of processors until now, of this process and of those it waited for: all, and those for compiling."""
    spent = processor_seconds()
    return spent["here"] + spent["processes"], spent["compiling"]


class RunSeconds:
    """Gathers from all workers."""

    def __init__(self, config):
        self.config = config
        self.workers: list[dict[str, float]] = []
        self.files: Counter = Counter()
        self.compiling: Counter = Counter()  # part of `files`
        self._phase_start = _spent()

    def pytest_sessionfinish(self, session):
        output = getattr(self.config, "workeroutput", None)
        if output is not None:
            output[KEY] = processor_seconds()

    def pytest_testnodedown(self, node, error):
        self.workers.append(getattr(node, "workeroutput", {}).get(KEY, {}))

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logstart(self, nodeid, location):
        self._phase_start = _spent()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item, call):
        """Where the test ran: what the phase took goes with its report."""
        report = yield
        now = _spent()
        report.raybatch_seconds = [end - start for start, end in zip(self._phase_start, now)]
        self._phase_start = now
        return report

    def pytest_runtest_logreport(self, report):
        name = Path(report.nodeid.partition("::")[0]).name
        total, compiling = getattr(report, "raybatch_seconds", (0.0, 0.0))
        self.files[name] += total
        self.compiling[name] += compiling

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
            for name, seconds in self.files.most_common(LISTED):
                terminalreporter.write_line(f"{seconds:7.1f} {self.compiling[name]:7.1f} compiling  {name}")


def pytest_configure(config):
    config.pluginmanager.register(RunSeconds(config), "run_seconds_gatherer")
