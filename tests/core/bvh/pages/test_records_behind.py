"""Records of instances behind the device, where a budget has no room for them: the same, and none counted twice."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core import host_memory
from raybatch_addon.core.bvh.build.entries import entries_of
from raybatch_addon.core.bvh.memory import ENTRY, GeometrySize
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.pages import build as page_build
from raybatch_addon.core.bvh.pages import resident
from raybatch_addon.core.bvh.pages.build import build_paged_scene
from raybatch_addon.core.bvh.tree import Tree
from raybatch_addon.core.host_memory import mapped_empty
from raybatch_addon.core.scene.flatten import flatten
from tests.core.bvh.pages.page_files import is_mapped
from tests.support import paged_scenes

RECORDS = (
    "entry_node",
    "entry_triangle",
    "entry_centre",
    "entry_from_world",
    "entry_instance",
    "entry_visibility",
    "merged_first",
    "entry_motion",
    "entry_deform",
)
STILL = ("nodes", "triangles", "top_entry", "merged_instance", "merged_triangle_first", "motion_keys")


def values(tree: Tree, name: str) -> bytes:
    array = getattr(tree, name)
    return b"" if array is None or not array.size else array.numpy().tobytes()


@pytest.mark.parametrize("made", [paged_scenes.everything, paged_scenes.living])
@pytest.mark.parametrize("store", ["HOST", "DISK"])
def test_they_are_those_of_the_device(made, store, tmp_path, monkeypatch):
    laid = []

    def lay(*asked, **options):
        laid.append(mapped_empty(*asked, **options))
        return laid[-1]

    monkeypatch.setattr(host_memory, "MAPPED_LEAST", 1)
    monkeypatch.setattr(page_build, "mapped_empty", lay)
    scene = made()
    flat, visibility, budget = flatten(scene), scene.instances.visibility, 400_000

    def build():
        return build_paged_scene(
            flat, visibility, Layout.BOXES, wp.get_device("cpu"), budget, store, tmp_path, nodes_resident=False
        )

    whole = build()
    monkeypatch.setattr(resident, "_RECORDS_SHARE", 0.0)
    behind = build()
    assert "records_behind" not in whole.statistics
    size = behind.statistics["records_behind"]
    assert whole.resident_bytes - behind.resident_bytes == size > 0
    arrays = {name: array for name in RECORDS if (array := getattr(behind.tree, name)) is not None and array.size}
    assert sum(int(each.capacity) for each in arrays.values()) == size
    for name in (*RECORDS, *STILL):
        assert values(behind.tree, name) == values(whole.tree, name), name
    assert all(map(is_mapped, laid))
    on_disk = {each.ctypes.data for each in laid} & {each.ptr for each in arrays.values()}
    assert len(on_disk) == (len(arrays) if store == "DISK" else 0)


def test_an_entry_takes_no_more_than_it_must():
    """On the host, while the top level is built: one map of float32, and a few numbers."""
    scene = paged_scenes.everything()
    flat = flatten(scene)
    entries = entries_of(flat, scene.instances.visibility)
    columns = [value for name, value in vars(entries).items() if isinstance(value, np.ndarray) and name != "transform"]
    own = [each for each in columns if len(each) in (len(entries), len(entries) + 1)]
    assert sum(each.nbytes for each in own) <= 80 * len(entries) + 4
    assert np.shares_memory(entries.transform, flat.instance_transform)


@pytest.mark.parametrize("layout", list(Layout))
def test_a_budget_counts_instances(layout):
    size = GeometrySize(1000, 600, 1000, False, instances=10_000_000, entries=10_000_000)
    none = GeometrySize(1000, 600, 1000, False)
    for count in ("tree_bytes_most", "tree_bytes"):
        assert getattr(size, count)(layout) - getattr(none, count)(layout) > ENTRY * size.entries
