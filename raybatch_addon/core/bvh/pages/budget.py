"""The size of pages, and the least budget that is enough: pure policy, without a device."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable

from ..memory import COPY_BYTES, PACKED_BYTES, PACKED_COPY_BYTES, PAGES_OVER, TREE_BYTES
from ..node import Layout
from .divide.primitives import Primitives
from .store import PAGE_ALIGNMENT

# A page is an eighth of the budget, and of the last three sizes where the budget allows [bytes]
_BUDGET_SHARE = 8
_SIZES = (*range(2 * PAGE_ALIGNMENT, 16 << 20, PAGE_ALIGNMENT), 16 << 20, 32 << 20, 64 << 20)
# The least budget of each size; what is smaller has the smallest pages
_LEAST = [0, *(size * _BUDGET_SHARE for size in _SIZES[1:])]
_NO_END = 1 << 62
# What a packed segment of a curve takes more than a packed triangle
_SEGMENT_BYTES = 19
# Triangles that are built, all trials together, to find a smaller budget than one that is known to be enough
_TRIALS_TRIANGLES = 1 << 23


def expected_bytes(primitives: Primitives, curves: bool, layout: Layout, encoded: bool) -> int:
    """Bytes of all pages, about. `curves`: segments are among the primitives."""
    each, copy = TREE_BYTES[layout], COPY_BYTES[layout]
    if encoded:
        each, copy = PACKED_BYTES + _SEGMENT_BYTES * curves, PACKED_COPY_BYTES
    return int(PAGES_OVER * (each * len(primitives.triangles) + copy * primitives.copies)) + (1 << 16)


def page_size(budget: int) -> int:
    """Bytes of a page at most, of a budget of so many bytes; of few sizes, so that files serve nearly equal budgets."""
    return _SIZES[_size_index(budget)]


def _size_index(budget: int) -> int:
    return bisect_right(_LEAST, max(budget, 0)) - 1


def _largest(index: int) -> int:
    """The largest budget of the pages of this size [bytes]."""
    return _LEAST[index + 1] - 1 if index + 1 < len(_LEAST) else _NO_END


def least_budget(budget: int, triangle_count: int, bound: Callable[[int], int], needed: Callable[[int], int]) -> int:
    """The least budget that is enough, above `budget`, which is not [bytes].

    Larger pages make fewer chunks, of which less must stay, but take more room by themselves. `needed` finds, by a
    trial, the bytes that are needed at least with pages of so many bytes; `bound` gives a number that is never more,
    without one. What is returned was tried. It is the least one where needs fall with the size of pages; for large
    scenes, where trials take long, it may be more than the least.
    """
    low, high = _size_index(budget), len(_SIZES) - 1
    while low < high:
        middle = (low + high) // 2
        if bound(_SIZES[middle]) > _largest(middle):
            low = middle + 1
        else:
            high = middle
    failed, index = low - 1, low
    while (found := needed(_SIZES[index])) > _largest(index):
        failed, index = index, max(index + 1, _size_index(found))
    trials = _TRIALS_TRIANGLES // max(triangle_count, 1)
    while index - failed > 1 and trials:
        middle, trials = (failed + index) // 2, trials - 1
        if (tried := needed(_SIZES[middle])) > _largest(middle):
            failed = middle
        else:
            index, found = middle, tried
    return max(found, _LEAST[index])
