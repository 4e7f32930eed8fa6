"""Tracers whose tree is not all in memory: pages come by faults, no more of them are there than the budget holds, and
hits are those of the tree in memory.
"""

import json
import platform

import benchmark
import numpy as np
import pytest
import warp as wp
from benchmarking.tracers.fault_memory import PAGE, FaultMemory
from lib.command import UsageError

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from tests.support.benchmark_scenes import assert_one_error, save_bowl


@wp.kernel(**KERNEL_OPTIONS)
def read_kernel(values: wp.array(dtype=wp.vec4), at: wp.array(dtype=int), found: wp.array(dtype=wp.vec4)):
    """By entry of `at`."""
    found[wp.tid()] = values[at[wp.tid()]]


def faulting(arrays, budget) -> FaultMemory:
    """The memory, where this system has it for us."""
    try:
        return FaultMemory(arrays, budget)
    except UsageError as error:
        assert "userfaultfd" in str(error) or platform.system() != "Linux"
        pytest.skip(str(error))


def test_pages_come_when_they_are_read_and_the_oldest_make_room():
    per_page = PAGE // 16
    values = [np.random.default_rng(k).random((5 * per_page + 1, 4)).astype(np.float32) for k in range(2)]
    memory = faulting([wp.array(each, dtype=wp.vec4, device="cpu") for each in values], 3 * PAGE + 5)

    def read(array: int, *pages: int) -> int:
        before = memory.pages_brought
        at = np.array([page * per_page + (page < 5) * 7 for page in pages], np.int32)
        found = wp.zeros(len(at), dtype=wp.vec4, device="cpu")
        wp.launch(
            read_kernel, len(at), [memory.arrays[array], wp.array(at, dtype=int, device="cpu"), found], device="cpu"
        )
        np.testing.assert_array_equal(found.numpy(), values[array][at])
        return memory.pages_brought - before

    try:
        assert read(0, 0, 1, 2, 0, 1, 2) == 3
        assert read(0, 5) == 1  # the last, which is not full; page 0 has left
        assert read(0, 1, 2, 5) == 0
        assert read(0, 0) == 1
        assert read(1, 0, 5, 0, 5) == 2  # a page of the other array is another page
        assert memory.bytes_brought == 7 * PAGE
    finally:
        memory.close()


def test_less_than_a_page_is_no_budget():
    with pytest.raises(UsageError, match="--budget 65535 is less than a page"):
        FaultMemory([], PAGE - 1)


def test_hits_are_those_in_memory_and_the_report_says_what_was_brought(tmp_path, capfd):
    faulting([], PAGE).close()
    geometry, report = save_bowl(tmp_path), tmp_path / "report.json"
    arguments = ["--scene", str(geometry), "--device", "cpu", "--rays", "primary", "--orders", "natural", "--runs", "1"]
    asked = ["--tracers", "off,off-sorted", "--rival", "orst", "--budget", str(PAGE), "--beyond", "--ray-count", "500"]
    assert benchmark.main(["traversal", *arguments, *asked, "--no-counters", "--json", str(report)]) == 0
    assert "MB of the tree were brought in" in capfd.readouterr().out
    found = json.loads(report.read_text())
    assert found["beyond"] and found["budget"] == PAGE and len(found["results"]) == 3
    for result in found["results"]:
        assert result["faults"] == 0
        assert result["bytes_copied"] > 0 and result["bytes_copied"] % PAGE == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "--beyond needs to know how much of the tree is there: give --budget BYTES"),
        (["--budget", "1Mi", "--rival", "raycrawler"], "--beyond: raycrawler has its tree in memory only"),
        (["--budget", "1Mi", "--tracers", "off,reference"], "--beyond: reference has its tree in memory only"),
    ],
)
def test_what_cannot_be_measured_beyond_memory_is_named(tmp_path, capfd, options, message):
    arguments = ["traversal", "--device", "cpu", "--scene", str(save_bowl(tmp_path)), "--beyond", *options]
    assert benchmark.main(arguments) == 1
    assert_one_error(capfd, message)
