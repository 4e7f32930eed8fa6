"""The processor's counters are numbers, or unavailable with a reason."""

import errno
import os
import struct
import threading
import time

import pytest

from raybatch_addon.core.measure import hardware
from raybatch_addon.core.measure.hardware import EVENTS, UNAVAILABLE, HardwareCounters, hardware_counters


def test_every_event_is_a_number_or_unavailable():
    with hardware_counters(False) as counters:
        sum(range(200_000))
    report = counters.report()
    for name in EVENTS:
        assert report[name] == UNAVAILABLE or (isinstance(report[name], int) and report[name] >= 0), name
    assert ("reason" in report) == (UNAVAILABLE in report.values())
    if report["instructions"] != UNAVAILABLE:
        assert report["instructions"] > 200_000


def test_threads_that_start_meanwhile_are_counted(monkeypatch):
    monkeypatch.setattr(hardware, "EVENTS", {"task_clock": (1, 1)})  # of the kernel's own, which needs no register
    spent = []

    def work():
        sum(range(1_000_000))
        spent.append(time.thread_time_ns())

    with HardwareCounters() as counters:
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
    found = counters.report()["task_clock"]
    if found == UNAVAILABLE:
        pytest.skip(counters.report()["reason"])
    assert found > 0.5 * spent[0]


@pytest.mark.parametrize(
    "number, word", [(errno.EACCES, "perf_event_paranoid"), (errno.ENOENT, "machine"), (errno.EINVAL, "Invalid")]
)
def test_the_reason_is_reported(monkeypatch, number, word):
    def refuse(kind, config):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(hardware, "_open", refuse)
    with HardwareCounters() as counters:
        pass
    report = counters.report()
    assert all(report[name] == UNAVAILABLE for name in EVENTS) and word in report["reason"]


def test_other_systems_do_without(monkeypatch):
    monkeypatch.setattr(hardware.sys, "platform", "win32")
    with HardwareCounters() as counters:
        pass
    assert "Linux" in counters.report()["reason"]


def test_counters_that_took_turns_are_scaled(monkeypatch):
    fcntl = pytest.importorskip("fcntl")
    monkeypatch.setattr(fcntl, "ioctl", lambda *_: 0)
    readings = iter([(500, 4, 2), (7, 1, 1), (9, 1, 0)])
    descriptors = []

    def pretend(kind, config):
        reading = next(readings, None)
        if reading is None:
            raise OSError(errno.ENOENT, "none")
        end, start = os.pipe()
        os.write(start, struct.pack("=QQQ", *reading))
        os.close(start)
        descriptors.append(end)
        return end

    monkeypatch.setattr(hardware, "_open", pretend)
    with HardwareCounters() as counters:
        pass
    report = counters.report()
    first, second, third, *others = EVENTS
    assert (report[first], report[second]) == (1000, 7)
    assert all(report[name] == UNAVAILABLE for name in (third, *others))
    for descriptor in descriptors:
        with pytest.raises(OSError):
            os.fstat(descriptor)


def test_cuda_devices_need_a_profiler():
    with hardware_counters(True) as counters:
        pass
    report = counters.report()
    assert all(report[name] == UNAVAILABLE for name in EVENTS) and "ncu" in report["reason"]
