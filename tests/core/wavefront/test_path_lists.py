"""Lists of path slots hold every path that belongs to them, in slot order, whatever the blocks; compared with NumPy."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.wavefront.path_lists import Length, PathLists
from raybatch_addon.core.wavefront.rays import BOUNCE_SHIFT, VISIBILITY_SHIFT, Status
from tests.support.under_test import DEVICE

PATHS = 1000
BLOCKS = (0, 32, 224, PATHS, 4096) if DEVICE != "cpu" else (0, 1, 7, 256, PATHS, 4096)


def statuses(seed: int, paths: int = PATHS) -> np.ndarray:
    """Statuses as they come up, and all others too, int32 [paths]."""
    rng = np.random.default_rng(seed)
    bounce = np.where(rng.random(paths) < 0.5, rng.integers(0, 5, paths), rng.integers(0, 100_002, paths))
    return (
        rng.integers(0, 128, paths) | (1 << rng.integers(0, 5, paths)) << VISIBILITY_SHIFT | bounce << BOUNCE_SHIFT
    ).astype(np.int32)


def lists_of(paths: int, block_size: int, walks: bool = False) -> PathLists:
    return PathLists(paths, wp.get_device(DEVICE), block_size, walks)


def slots_of(listed) -> list[int]:
    return listed.slots.numpy()[: int(listed.count.numpy()[0])].tolist() if listed.bound else []


def has(status: np.ndarray, bits: Status) -> np.ndarray:
    return (status & int(bits)) != 0


WAITING = Status.RAY_NEW | Status.RAY_OUT | Status.SHADOW_NEW | Status.SHADOW_OUT


def few_alive(seed: int) -> np.ndarray:
    """Statuses of a tile that comes to its end: runs of free slots, of every length, with paths between them, int32
    [PATHS].
    """
    rng = np.random.default_rng(seed)
    before = statuses(seed)
    before[np.repeat(rng.random(PATHS) < 0.9, rng.integers(1, 70, PATHS))[:PATHS]] &= ~int(Status.ALIVE)
    return before


@pytest.mark.parametrize("statuses_of", [statuses, few_alive])
@pytest.mark.parametrize("by_bounce, with_free", [(False, True), (True, True), (False, False), (True, False)])
@pytest.mark.parametrize("block_size", BLOCKS)
def test_the_lists_of_a_turn(block_size, by_bounce, with_free, statuses_of):
    before = statuses_of(block_size)
    status, lists = wp.array(before, device=DEVICE), lists_of(PATHS, block_size)
    lists._slots.fill_(-1)
    done = lists.end_turn(status, PATHS, by_bounce, with_free)
    lengths = lists.counts.fetch()
    turn = lists.next_turn(lengths, by_bounce, with_free)
    alive = has(before, Status.ALIVE)
    ended = alive & has(before, Status.ENDED) & ~has(before, WAITING)
    goes_on = alive & ~ended
    new, shadow, bounce = (
        goes_on & has(before, Status.RAY_NEW),
        goes_on & has(before, Status.SHADOW_NEW),
        before >> BOUNCE_SHIFT,
    )
    assert slots_of(done) == np.flatnonzero(ended).tolist()
    if with_free:
        assert turn.free.numpy().tolist() == [*np.flatnonzero(ended), *np.flatnonzero(~alive)]
    else:
        assert turn.free is None and lengths[Length.FREE] == 0
    assert (lists._slots.numpy() >= 0).sum() == ended.sum() + new.sum() + shadow.sum() + (
        with_free and (~alive).sum()
    ), "nothing else is listed"
    assert slots_of(turn.shadow) == (PATHS + np.flatnonzero(shadow)).tolist() and turn.shadow.bound == shadow.sum()
    classes = [np.flatnonzero(new & chosen).tolist() for chosen in (bounce <= 1, bounce == 2, bounce > 2)]
    expected = np.concatenate(classes).tolist() if by_bounce else np.flatnonzero(new).tolist()
    assert slots_of(turn.bounced) == expected and turn.bounced.bound == len(expected)
    assert [slots_of(part) for part in turn.bounced_parts] == (classes if by_bounce else [])
    flips = np.where(new, int(Status.RAY_NEW | Status.RAY_OUT), 0) | np.where(
        shadow, int(Status.SHADOW_NEW | Status.SHADOW_OUT), 0
    )
    assert np.array_equal(status.numpy(), before ^ flips), "listed rays count as under way"


@pytest.mark.parametrize("by_bounce", [False, True])
@pytest.mark.parametrize("block_size", BLOCKS)
def test_steps_of_walks_are_listed_as_later_bounces(block_size, by_bounce):
    before = statuses(200 + block_size)
    inside = np.random.default_rng(block_size).random(PATHS) < 0.5
    before[inside] |= int(Status.INSIDE)
    status, lists = wp.array(before, device=DEVICE), lists_of(PATHS, block_size, walks=True)
    lists.end_turn(status, PATHS, by_bounce, True)
    turn = lists.next_turn(lists.counts.fetch(), by_bounce, True)
    new, bounce = has(before, Status.ALIVE) & has(before, Status.RAY_NEW), before >> BOUNCE_SHIFT
    chosen = (~inside & (bounce <= 1), ~inside & (bounce == 2), inside | (bounce > 2))
    classes = [np.flatnonzero(new & each).tolist() for each in chosen]
    assert all(classes) and slots_of(turn.bounced) == (
        np.concatenate(classes).tolist() if by_bounce else np.flatnonzero(new).tolist()
    )
    assert [slots_of(part) for part in turn.bounced_parts] == (classes if by_bounce else [])


@pytest.mark.parametrize("statuses_of", [statuses, few_alive])
@pytest.mark.parametrize("block_size", BLOCKS)
def test_paths_whose_rays_are_back(block_size, statuses_of):
    before = statuses_of(100 + block_size)
    status, lists = wp.array(before, device=DEVICE), lists_of(PATHS, block_size)
    miss, surface = lists.back(status, PATHS)
    shaded = has(before, Status.ALIVE) & ~has(before, WAITING | Status.ENDED)
    assert slots_of(miss) == np.flatnonzero(shaded & ~has(before, Status.HIT)).tolist()
    assert slots_of(surface) == np.flatnonzero(shaded & has(before, Status.HIT)).tolist()
    assert np.array_equal(status.numpy(), before)


@pytest.mark.parametrize(
    "bits", [0, int(Status.ALIVE | Status.RAY_NEW | Status.SHADOW_NEW), int(Status.ALIVE | Status.ENDED)]
)
@pytest.mark.parametrize("paths", [1, 33, 64])
def test_all_paths_alike(paths, bits):
    lists = lists_of(paths, 0)
    status = wp.full(paths, bits, dtype=int, device=DEVICE)
    done = lists.end_turn(status, paths, True, True)
    lengths = lists.counts.fetch()
    turn = lists.next_turn(lengths, True, True)
    everyone = list(range(paths))
    waits = bool(bits & int(Status.RAY_NEW))
    assert (turn.free is None) == waits and slots_of(done) == (everyone if bits & int(Status.ENDED) else [])
    assert slots_of(turn.bounced) == slots_of(turn.bounced_parts[0]) == (everyone if waits else [])
    assert slots_of(turn.shadow) == ([paths + p for p in everyone] if waits else [])
    assert lengths[Length.DONE] + lengths[Length.FREE] == (0 if waits else paths)


def test_at_first_every_slot_is_free():
    lists = lists_of(PATHS, 0)
    assert lists.all_free(wp.zeros(PATHS, dtype=int, device=DEVICE)).numpy().tolist() == list(range(PATHS))


def test_lists_are_made_again_and_again_in_the_same_memory():
    lists = lists_of(PATHS, 64)
    for seed in range(4):
        before = statuses(seed)
        status = wp.array(before, device=DEVICE)
        _miss, _surface = lists.back(status, PATHS)
        lists.end_turn(status, PATHS, bool(seed % 2), bool(seed // 2))
        again, _ = lists.back(wp.array(before, device=DEVICE), PATHS)
        assert slots_of(again) == slots_of(lists_of(PATHS, 0).back(wp.array(before, device=DEVICE), PATHS)[0])
