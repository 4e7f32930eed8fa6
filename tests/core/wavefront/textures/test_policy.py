"""Which tiles come and which stay."""

import numpy as np
import pytest

from raybatch_addon.core.wavefront.textures.policy import choose_tiles, urgency_of


def chosen(counts, there, slots, most, leads=()):
    leading = np.isin(np.arange(len(counts)), leads)
    missing, kept = choose_tiles(urgency_of(np.array(counts), leading), np.array(there, bool), slots, most)
    return missing.tolist(), kept.tolist()


def test_what_most_rays_wait_for_comes_and_what_is_there_stays():
    assert chosen([5, 9, 7, 1], [0, 0, 0, 1], 3, 3) == ([1, 2], [3])
    assert chosen([5, 9, 7, 1], [0, 0, 0, 1], 3, 1) == ([1], [3])
    assert chosen([5, 9], [0, 0], 4, 4) == ([0, 1], [])


def test_some_slots_are_left_to_what_is_missing():
    counts = [*range(8, 0, -1), 1, 1, 1]
    missing, kept = chosen(counts, [1] * 8 + [0] * 3, 8, 4)
    assert len(missing) == 2 and kept == [0, 1, 2, 3, 4, 5]


def test_tiles_of_the_ray_that_leads_stay_and_come_first():
    assert chosen([9, 9, 1, 1], [1, 1, 0, 0], 2, 1, leads=[1, 3]) == ([3], [1])
    assert chosen([9, 1, 1], [1, 1, 1], 3, 1, leads=[0]) == ([], [0, 1, 2])


@pytest.mark.parametrize("seed", range(20))
def test_the_ray_that_leads_has_all_of_its_tiles_after_some_turns(seed):
    random = np.random.default_rng(seed)
    slots = int(random.integers(1, 12))
    needs = random.choice(30, int(random.integers(1, slots + 1)), replace=False)
    most, there = int(random.integers(1, slots + 1)), np.zeros(30, bool)
    for _ in range(len(needs)):
        counts = random.integers(0, 50, 30)
        counts[needs] += 1
        wanted = np.flatnonzero(counts)
        urgency = urgency_of(counts[wanted], np.isin(wanted, needs))
        missing, kept = (wanted[each] for each in choose_tiles(urgency, there[wanted], slots, most))
        assert len(missing) <= most and len(missing) + len(kept) <= slots
        assert not there[missing].any() and there[kept].all()
        there[:] = False
        there[missing] = there[kept] = True
    assert there[needs].all()
