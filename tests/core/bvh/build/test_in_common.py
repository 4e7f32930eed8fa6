"""Trees of several devices: one builds them, and the others get copies."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

from raybatch_addon.core.bvh.build import in_common
from raybatch_addon.core.bvh.build.in_common import TreesInCommon
from raybatch_addon.core.bvh.build.mesh_tree import MeshPart, MeshTree


def gpu(alias: str, name: str = "one", fails_with: Exception | None = None) -> SimpleNamespace:
    return SimpleNamespace(alias=alias, name=name, arch=90, is_cuda=True, is_cpu=False, fails_with=fails_with)


def tree_on(device, triangles: int) -> MeshTree:
    """A tree whose arrays are stand-ins: where they lie."""
    return MeshTree(
        part=MeshPart(0, triangles, 0, 3),
        nodes=SimpleNamespace(device=device),
        triangles=SimpleNamespace(device=device),
        centre=np.zeros(3),
        box=np.zeros((2, 3)),
        node_count=1,
        depth=1,
        sah=1.0,
        sah_built=1.0,
        split=False,
        splits=False,
        level_first=[0, 1],
    )


@pytest.fixture(autouse=True)
def copies(monkeypatch):
    """Each copy of an array: where it lay, and where to."""
    made = []

    def copied(array, device):
        made.append((array.device.alias, device.alias))
        if device.fails_with:
            raise device.fails_with
        return SimpleNamespace(device=device)

    monkeypatch.setattr(in_common, "copied_to", copied)
    return made


def asked_by_all(common, devices, build):
    """What each device gets; all ask while the first of them builds."""

    def ask(device):
        if device is not devices[0]:
            begun.wait(10)
        return common.get(device, "trees", lambda: built(device))

    def built(device):
        if not begun.is_set():
            begun.set()
            deadline = time.monotonic() + 10
            while sum(map(len, common._waiting.values())) < waiting and time.monotonic() < deadline:
                time.sleep(0.001)
        return build(device)

    begun, waiting = threading.Event(), sum(each.name == devices[0].name for each in devices) - 1
    with ThreadPoolExecutor(len(devices)) as pool:
        return [each.result(10) for each in [pool.submit(ask, device) for device in devices]]


def test_one_builds_and_all_have_their_own(copies):
    devices, builders = [gpu(f"cuda:{i}") for i in range(3)], []

    def build(device):
        builders.append(device.alias)
        return [tree_on(device, 1), tree_on(device, 2)]

    found = asked_by_all(TreesInCommon(devices), devices, build)
    assert builders == ["cuda:0"]
    for device, trees in zip(devices, found, strict=True):
        assert [each.part.triangle_count for each in trees] == [1, 2]
        assert {each.nodes.device.alias for each in trees} == {device.alias}
        assert {each.triangles.device.alias for each in trees} == {device.alias}
    lists = [each.over_time for trees in found for each in trees]
    assert len({id(each) for each in lists}) == 6  # which devices fill
    assert sorted(copies) == [("cuda:0", "cuda:1")] * 4 + [("cuda:0", "cuda:2")] * 4


def test_who_asks_late_or_is_of_another_model_builds(copies):
    devices, builders = [gpu("cuda:0"), gpu("cuda:1", "other"), gpu("cuda:2")], []

    def build(device):
        builders.append(device.name)
        return [tree_on(device, 1)]

    common = TreesInCommon(devices)
    asked_by_all(common, devices, build)
    assert sorted(builders) == ["one", "other"]
    common.get(devices[2], "trees", lambda: build(devices[2]))
    assert sorted(builders) == ["one", "one", "other"]
    assert len(copies) == 2 and not common._waiting  # nothing is kept for who does not ask


def test_trees_of_the_host_are_shared(copies):
    devices, host = [gpu("cuda:0"), gpu("cuda:1")], SimpleNamespace(alias="cpu", is_cuda=False)
    found = asked_by_all(TreesInCommon(devices), devices, lambda device: [tree_on(host, 1)])
    assert found[0][0].nodes is found[1][0].nodes and not copies
    assert found[0][0] is not found[1][0] and found[0][0].over_time is not found[1][0].over_time


@pytest.mark.parametrize("error", [RuntimeError("Failed to allocate 8 bytes"), ValueError("a copy that fails")])
def test_a_device_that_gets_no_copy_builds_its_own(error):
    devices, builders = [gpu("cuda:0"), gpu("cuda:1", fails_with=error), gpu("cuda:2")], []

    def build(device):
        builders.append(device.alias)
        return [tree_on(device, 1)]

    found = asked_by_all(TreesInCommon(devices), devices, build)
    assert builders == ["cuda:0", "cuda:1"]
    assert [each[0].nodes.device for each in found] == devices


def test_where_one_fails_the_others_try():
    devices, tried = [gpu("cuda:0"), gpu("cuda:1")], []

    def build(device):
        tried.append(device.alias)
        if device is devices[0]:
            raise MemoryError("no room")
        return [tree_on(device, 1)]

    with pytest.raises(MemoryError, match="no room"):
        asked_by_all(TreesInCommon(devices), devices, build)
    assert tried == ["cuda:0", "cuda:1"]
