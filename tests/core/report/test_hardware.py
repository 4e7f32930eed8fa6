"""The processor's counters are numbers, or unavailable with a reason."""

import errno
import os
import struct
import threading

import pytest

from raybatch_addon.core.report import hardware
from raybatch_addon.core.report.hardware import EVENTS, UNAVAILABLE, HardwareCounters, hardware_counters


def test_every_event_is_a_number_or_unavailable():
    with hardware_counters(False) as counters:
        thread = threading.Thread(target=sum, args=(range(200_000),))
        thread.start()
        thread.join()
    report = counters.report()
    for name in EVENTS:
        assert report[name] == UNAVAILABLE or (isinstance(report[name], int) and report[name] >= 0), name
    assert ("reason" in report) == (UNAVAILABLE in report.values())
    if report["instructions"] != UNAVAILABLE:
        assert report["instructions"] > 200_000, "threads that were started meanwhile are counted"


@pytest.mark.parametrize("number, word", [(errno.EACCES, "perf_event_paranoid"), (errno.ENOENT, "machine"), (errno.EINVAL, "Invalid")])
def test_the_reason_is_told(monkeypatch, number, word):
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
