"""Records of instances behind the device, where a budget has no room for them: the same, and none counted twice."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.build.entries import entries_of
from raybatch_addon.core.bvh.memory import ENTRY, GeometrySize
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.pages import resident
from raybatch_addon.core.bvh.pages.build import build_paged_scene
from raybatch_addon.core.device import mapped
from raybatch_addon.core.scene.flatten import flatten
from tests.support import paged_scenes
from tests.support.mapped_arrays import is_mapped

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


@pytest.mark.parametrize("made", [paged_scenes.everything, paged_scenes.living])
@pytest.mark.parametrize("store", ["HOST", "DISK"])
def test_they_are_those_of_the_device(made, store, tmp_path, monkeypatch):
    monkeypatch.setattr(mapped, "MAPPED_LEAST", 1)
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
    arrays = {name: getattr(behind.tree, name) for name in RECORDS if getattr(behind.tree, name) is not None}
    assert sum(int(each.capacity) for each in arrays.values()) == size
    for name in (*RECORDS, *STILL):
        own, other = getattr(behind.tree, name), getattr(whole.tree, name)
        assert (own is None) == (other is None)
        if own is not None:
            assert own.numpy().tobytes() == other.numpy().tobytes(), name
    mapped_ones = [is_mapped(each.numpy()) for each in arrays.values() if each.size]
    assert all(mapped_ones) if store == "DISK" else not any(mapped_ones)


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
