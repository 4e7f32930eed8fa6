"""The study of many workers: its simulator against closed forms, and against what was measured."""

import heapq
import math
from dataclasses import replace

import numpy as np
import pytest
from studies.many_workers import devices, jobs, results
from studies.many_workers.clock import Clock, Line, Port, transfer
from studies.many_workers.cluster import simulated
from studies.many_workers.model import FREE, Job, Site
from studies.rows import read_report

from tests.support.command_line import ROOT

STILL = Job(seconds=600.0, samples=4096, width=640, height=360)  # one band
EVEN = Site(gpus=8, spread=0.0)


def test_events_come_in_the_order_of_their_times():
    clock, seen = Clock(), []
    for seconds in (3.0, 1.0, 2.0, 1.0):
        clock.at(seconds, lambda seconds=seconds: seen.append((seconds, clock.now)))
    clock.after(1.5, lambda: clock.after(1.0, lambda: seen.append(("later", clock.now))))
    clock.run()
    assert seen == [(1.0, 1.0), (1.0, 1.0), (2.0, 2.0), ("later", 2.5), (3.0, 3.0)]


def test_a_line_serves_one_after_another():
    clock, ends = Clock(), []
    line = Line(clock)
    for seconds in (2.0, 1.0, 3.0):
        line.serve(seconds, lambda: ends.append(clock.now))
    clock.run()
    assert ends == [2.0, 3.0, 6.0] and line.busy == 6.0


def test_transfers_take_both_ports():
    """The slower one tells how long; those of other ports go on meanwhile; within a machine bytes take no time."""
    clock, ends = Clock(), {}
    fast, slow, other, last = (Port(clock, rate) for rate in (100.0, 50.0, 100.0, 100.0))
    for name, source, target in (("a", fast, slow), ("b", fast, other), ("c", last, other), ("d", slow, slow)):
        transfer(clock, source, target, 100.0, 0.5, lambda name=name: ends.setdefault(name, clock.now))
    clock.run()
    assert ends == {"d": 0.5, "a": 2.5, "b": 3.5, "c": 4.5}


@pytest.mark.parametrize("gpus", [1, 2, 7, 8])
def test_equal_workers_without_costs_share_the_work(gpus):
    """What is lost is what the last tasks differ by, and these are short."""
    found = simulated(FREE, replace(EVEN, gpus=gpus), STILL)
    least = STILL.seconds / gpus
    assert least * (1 - 1e-9) <= found.seconds <= least + 1.0
    lost = sum(vars(found.losses).values())
    assert found.useful + lost == pytest.approx(found.gpus * found.seconds)
    assert found.losses.shared == pytest.approx(0.0, abs=1e-6)


def test_a_slow_worker_does_less():
    """One of two at half the rate: together they do 1.5 times as much as one."""
    found = simulated(FREE, replace(EVEN, gpus=2, slow_share=0.5), STILL)
    assert STILL.seconds / 1.5 <= found.seconds <= STILL.seconds / 1.5 + 2.0


def test_what_every_worker_does_first_is_not_shared():
    job = replace(STILL, kernel_seconds=5.0, build_seconds=2.0)
    found = simulated(FREE, EVEN, job)
    assert found.seconds == pytest.approx(7.0 + STILL.seconds / 8, abs=1.0)
    assert found.losses.kernels == pytest.approx(8 * 7.0)


def test_a_scene_goes_to_one_machine_in_its_time_and_to_many_in_little_more():
    """Machines pass it on: to 64 it takes a few times as long as to one, from one source it would take 64 times."""
    job, site = replace(STILL, scene_bytes=1e9), replace(EVEN, bandwidth=1e9)
    one, many = (simulated(FREE, replace(site, gpus=gpus), job) for gpus in (8, 512))
    assert one.losses.scene / one.gpus == pytest.approx(1.0, rel=0.01)
    assert 1.0 < many.losses.scene / many.gpus < 8.0


def test_workers_wait_for_messages_between_tasks():
    """Between tasks a worker waits for the messages, but where another task waits for it."""
    costs = replace(FREE, latency=0.1)
    none, one = (simulated(costs, replace(EVEN, ahead=ahead), STILL) for ahead in (0, 1))
    assert none.losses.waits > 5 * one.losses.waits >= 0.0
    assert none.losses.waits >= 0.2 * (none.tasks - 8)


def test_frames_overlap():
    """Frames one after another would each wait for their own end."""
    job = replace(STILL, seconds=60.0, frames=6)
    alone, together = (simulated(FREE, EVEN, replace(job, under_way=n)) for n in (1, 2))
    assert together.seconds < alone.seconds
    assert together.useful == 360.0 and together.speedup > 7.0


def test_amdahls_law_and_its_inverse():
    assert devices.amdahl(4, 0.0) == 4.0 and devices.amdahl(4, 1.0) == 1.0
    assert devices.amdahl(math.inf, 0.05) == pytest.approx(20.0)
    assert devices.serial_share(4, devices.amdahl(4, 0.07)) == pytest.approx(0.07)


def test_one_gpu_takes_its_time_whatever_several_lose():
    assert devices.process_seconds(devices.Shared("one", 1024, 10.0, 0.3, 40, 1), 0.3) == pytest.approx(10.0)
    two = devices.Shared("two", 1024, 10.0, 0.3, 40, 2)
    assert devices.process_seconds(two, 0.3) - devices.process_seconds(two, 0.0) == pytest.approx(0.3)


def test_parts_bring_gpus_to_the_end_together():
    """Eight GPUs and 128 tiles, the last of which take twice as long: whole tiles as they come would end later."""
    tiles = np.linspace(1.0, 2.0, 128).tolist()
    least, free = sum(tiles) / 8, [0.0] * 8
    for seconds in tiles:
        heapq.heapreplace(free, free[0] + seconds)
    assert least <= devices.dealt_seconds(tiles, 1024, 8) < 1.01 * least < max(free)
    assert devices.dealt_seconds([3.0, 1.0], 16, 1) == pytest.approx(4.0)  # two workers share a GPU


def test_what_was_not_measured_is_predicted_from_what_was():
    """Between what it would be if shares of the work were lost, and if nothing were."""
    for case in jobs.PREDICTED:
        assert not case.speedup and case.gpus > max(each.gpus for each in jobs.MEASURED), case
        assert devices.amdahl(case.gpus, results.not_shared()) < results.speedup(case) < case.gpus, case


def test_measured_speedups_are_met():
    """Those of GPUs of a process within 0.3 percent, by one figure for all of them, or within two where runs themselves
    differ by more; those of two workers within 10.
    """
    for case in jobs.MEASURED:
        within = 0.003 if case.samples == 1024 else 0.02
        assert results.speedup(case) == pytest.approx(case.speedup, rel=within), case
    costs = results.costs_of(read_report(ROOT / "docs/studies/data/many-workers-cpu.json"))
    for alone, measured in jobs.LOCAL:
        assert jobs.LOCAL_START + simulated(costs, *jobs.local_job(alone)).seconds == pytest.approx(measured, rel=0.1)
