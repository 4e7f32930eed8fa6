"""Intervals are timed without waiting, by a clock that is made up here and by the device's own."""

import time

import pytest
import warp as wp

from raybatch_addon.core.measure.timing import (
    PENDING_MAX,
    STAGES,
    HostClock,
    NoTimer,
    StageTimer,
    Stopwatch,
    clock_of,
    cost_clock_of,
)
from tests.support.under_test import DEVICE


class SlowClock:
    """A device that is said to be faster than it works: marks are numbers, and those up to `now` are past."""

    def __init__(self):
        self.now = self.given = 0
        self.held = 0

    def mark(self):
        self.given += 1
        self.held += 1
        return self.given

    def is_past(self, mark):
        return mark <= self.now

    def seconds(self, start, end):
        self.now = max(self.now, end)
        return float(end - start)

    def release(self, mark):
        self.held -= 1


def test_times_come_when_the_device_is_done_and_in_order():
    clock = SlowClock()
    watch = Stopwatch(clock)
    for tag in "abc":
        watch.start(tag)
        watch.stop()
    assert watch.take() == []
    clock.now = 4
    assert watch.take() == [("a", 1.0), ("b", 1.0)]
    assert watch.take(wait=True) == [("c", 1.0)]
    assert clock.held == 0, "marks are given back"


def test_no_more_than_so_many_intervals_are_under_way():
    clock = SlowClock()
    watch = Stopwatch(clock)
    for i in range(PENDING_MAX + 10):
        watch.start(i)
        watch.stop()
    assert [tag for tag, _ in watch.take()] == list(range(10))


def test_stages_add_up():
    clock = SlowClock()
    timer = StageTimer(clock)
    for _ in range(100):
        for name in ("trace", "shade"):
            with timer.stage(name):
                clock.mark()
    assert timer.totals() == dict.fromkeys(STAGES, 0.0) | {"trace": 200.0, "shade": 200.0}


def test_a_stage_within_a_stage_is_refused():
    timer = StageTimer(HostClock())
    with pytest.raises(AssertionError, match="sort"), timer.stage("trace"), timer.stage("sort"):
        pass


def test_no_timer_gives_nothing():
    timer = NoTimer()
    with timer.stage("trace"), timer.stage("sort"):
        pass
    assert timer.totals() == {}


def test_the_devices_own_clock_measures_how_long_work_takes():
    device = wp.get_device(DEVICE)
    array = wp.zeros(1 << 24, dtype=float, device=device)
    timer = StageTimer(clock_of(device))
    for _ in range(3):
        with timer.stage("film"):
            array.fill_(1.0)
    seconds = timer.totals()
    assert 3e-6 < seconds["film"] < 60 and seconds["trace"] == 0.0


@pytest.mark.skipif(
    time.get_clock_info("thread_time").resolution > 1e-6, reason="this system tells a thread's time too coarsely"
)
def test_waiting_is_no_cost_on_the_cpu():
    watch = Stopwatch(cost_clock_of(wp.get_device("cpu")))
    watch.start("slept")
    time.sleep(0.1)
    watch.stop()
    watch.start("worked")
    sum(range(300_000))
    watch.stop()
    (_, slept), (_, worked) = watch.take()
    assert slept < 0.05 and worked > 1e-4
