"""The least budget that is enough, found by trying sizes of pages."""

import numpy as np
import pytest

from raybatch_addon.core.bvh.pages.budget import least_budget, page_size


def needs(constant: int, share: float, places: int):
    """What scenes need: `constant` bytes, and fewer the larger pages are, and `places` for a page."""
    return lambda size: int(constant + share / size + places * size)


@pytest.mark.parametrize("seed", range(40))
def test_it_is_enough_and_one_byte_less_is_not(seed):
    rng = np.random.default_rng(seed)
    needed = needs(int(10 ** rng.uniform(0, 9)), 10 ** rng.uniform(5, 15), int(rng.integers(1, 3)))
    tried = []

    def trial(size: int) -> int:
        tried.append(size)
        return needed(size)

    asked = 1
    found = least_budget(asked, 1000, lambda size: needed(size) // 3, trial)
    assert needed(page_size(found)) <= found and page_size(found) in tried
    assert needed(page_size(found - 1)) > found - 1
    assert len(tried) <= 25
    # what is asked for does not matter
    for asked in (found - 1, found // 2):
        assert least_budget(asked, 1000, lambda size: 0, needed) == found


def test_large_scenes_are_tried_a_few_times():
    tried = []

    def trial(size: int) -> int:
        tried.append(size)
        return needs(1 << 20, 1e14, 1)(size)

    found = least_budget(1, 10**8, lambda size: int(2e13 / size), trial)
    assert found >= needs(1 << 20, 1e14, 1)(page_size(found)) and len(tried) <= 3
