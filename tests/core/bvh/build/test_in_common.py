"""Trees of several devices: one builds them, and the others get copies."""

import threading
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

from raybatch_addon.core.bvh.build import in_common
from raybatch_addon.core.bvh.build.in_common import TreesInCommon
from raybatch_addon.core.bvh.build.mesh_tree import MeshPart, MeshTree


def gpu(alias: str, name: str = "one", is_full: bool = False) -> SimpleNamespace:
    return SimpleNamespace(alias=alias, name=name, arch=90, is_cuda=True, is_cpu=False, is_full=is_full)


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
        if device.is_full:
            raise RuntimeError("Failed to allocate 8 bytes on device 'cuda:2'")
        return SimpleNamespace(device=device)

    monkeypatch.setattr(in_common, "copied_to", copied)
    return made


def asked_by_all(common, devices, kind, build):
    """What each device gets; all ask at the same time."""
    ready = threading.Barrier(len(devices))

    def ask(device):
        ready.wait(10)
        return common.get(device, kind, lambda: build(device))

    with ThreadPoolExecutor(len(devices)) as pool:
        return [each.result(10) for each in [pool.submit(ask, device) for device in devices]]


def test_one_builds_and_all_have_their_own(copies):
    devices, builders = [gpu(f"cuda:{i}") for i in range(3)], []

    def build(device):
        builders.append(device.alias)
        return [tree_on(device, 1), tree_on(device, 2)]

    found = asked_by_all(TreesInCommon(devices), devices, "trees", build)
    assert len(builders) == 1
    for device, trees in zip(devices, found, strict=True):
        assert [each.part.triangle_count for each in trees] == [1, 2]
        assert {each.nodes.device.alias for each in trees} == {device.alias}
        assert {each.triangles.device.alias for each in trees} == {device.alias}
    lists = [each.over_time for trees in found for each in trees]
    assert len({id(each) for each in lists}) == 6  # which devices fill
    others = {each.alias for each in devices} - set(builders)
    assert sorted(copies) == sorted([(builders[0], other) for other in others] * 4)


def test_other_models_and_other_trees_are_built_apart():
    devices, builders = [gpu("cuda:0"), gpu("cuda:1", "other"), gpu("cuda:2")], []

    def build(device):
        builders.append(device.name)
        return [tree_on(device, 1)]

    common = TreesInCommon(devices)
    asked_by_all(common, devices, "trees", build)
    assert sorted(builders) == ["one", "other"]
    common.get(devices[0], "finer trees", lambda: build(devices[0]))
    assert sorted(builders) == ["one", "one", "other"]


def test_trees_of_the_host_are_nobodys_copies(copies):
    devices, host = [gpu("cuda:0"), gpu("cuda:1")], SimpleNamespace(alias="cpu", is_cuda=False)
    found = asked_by_all(TreesInCommon(devices), devices, "trees", lambda device: [tree_on(host, 1)])
    assert [each[0].nodes.device.alias for each in found] == ["cpu", "cpu"] and not copies


def test_a_device_without_room_builds_its_own():
    devices, builders = [gpu("cuda:0"), gpu("cuda:1", is_full=True), gpu("cuda:2")], []

    def build(device):
        builders.append(device.alias)
        return [tree_on(device, 1)]

    common = TreesInCommon(devices)
    found = [common.get(device, "trees", lambda device=device: build(device)) for device in devices]
    assert builders == ["cuda:0", "cuda:1"]
    assert [each[0].nodes.device for each in found] == devices


def test_where_one_fails_the_others_try():
    devices = [gpu("cuda:0"), gpu("cuda:1")]
    common = TreesInCommon(devices)

    def fails():
        raise MemoryError("no room")

    with pytest.raises(MemoryError, match="no room"):
        common.get(devices[0], "trees", fails)
    found = common.get(devices[1], "trees", lambda: [tree_on(devices[1], 1)])
    assert found[0].nodes.device is devices[1]
