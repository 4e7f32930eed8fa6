"""The memory that a render will take, from counts."""

import dataclasses

import pytest

from raybatch_addon.core.bvh.memory import TREE_BYTES, GeometrySize
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.host_memory import size_text
from raybatch_addon.core.measure.memory import estimate_memory

SIZE = GeometrySize(triangles=1_000_000, vertices=500_000, largest=1_000_000, smooth=False)


@pytest.mark.parametrize("layout", list(Layout))
def test_parts_add_up(layout):
    whole = estimate_memory(SIZE, layout, path_bytes=100, path_count=3000)
    assert (
        whole.rays == 300_000
        and whole.geometry == 18_000_000
        and whole.tree == whole.resident == TREE_BYTES[layout] * 10**6
    )
    assert whole.behind == 0 and whole.device == whole.rays + whole.geometry + whole.tree
    part = estimate_memory(SIZE, layout, 100, 3000, budget=10**7)
    assert (part.resident, part.behind, part.device) == (10**7, whole.tree - 10**7, whole.device - part.behind)
    assert estimate_memory(SIZE, layout, 100, 3000, budget=10**12) == whole
    known = estimate_memory(SIZE, layout, 100, 3000, budget=10**7, tree_bytes=10**9)
    assert (known.tree, known.resident) == (10**9, 10**7)
    smooth = estimate_memory(dataclasses.replace(SIZE, smooth=True), layout, 100, 3000)
    assert smooth.geometry - whole.geometry == 36_000_000


def test_sizes_in_words():
    for size, text in (
        (0, "0 bytes"),
        (999, "999 bytes"),
        (1500, "1.50 KB"),
        (12_345_678, "12.3 MB"),
        (999_000_000, "999 MB"),
        (7_123_456_789, "7.12 GB"),
        (10**13, "10,000 GB"),
    ):
        assert size_text(size) == text
