"""Ranges of samples: each is dealt once, small at first and at the end, and films are merged in a tree."""

import dataclasses
import itertools
import random

import pytest

from raybatch_addon.core.cluster.ranges import (
    LEAST_SECONDS,
    STRAGGLER_SECONDS,
    TASK_SECONDS,
    TASK_TIMES_FILM,
    MergeTree,
    RangeDeal,
    SampleRange,
)


def dealt_by_workers(total, speeds):
    """Ranges in the order in which they were dealt, to workers that take so many seconds a sample, and when each worker
    was through [s].
    """
    deal, free, dealt = RangeDeal(100, 100 + total), [0.0] * len(speeds), []
    running: list[tuple[float, int, SampleRange]] = []
    while True:
        for i in range(len(speeds)):
            if all(each[1] != i for each in running) and (samples := deal.next(len(speeds))) is not None:
                dealt.append(samples)
                free[i] += samples.count * speeds[i]
                running.append((free[i], i, samples))
        if not running:
            return dealt, free
        running.sort()
        now, i, samples = running.pop(0)
        deal.note(samples, samples.count * speeds[i], 0.0)
        idle = [j for j in range(len(speeds)) if all(each[1] != j for each in running)]
        for j in idle:
            free[j] = max(free[j], now) if not deal.is_dealt else free[j]


@pytest.mark.parametrize("speeds", [[0.1], [0.1] * 7, [0.02, 0.1, 0.3], [3.0, 1.0]])
@pytest.mark.parametrize("total", [1, 2, 37, 4096])
def test_all_samples_are_dealt_once_and_in_order(total, speeds):
    dealt, _ = dealt_by_workers(total, speeds)
    assert dealt[0].first == 100 and dealt[-1].end == 100 + total
    assert all(a.end == b.first and a.count > 0 for a, b in itertools.pairwise(dealt))


@pytest.mark.parametrize("speeds", [[0.1] * 4, [0.05, 0.1, 0.2, 0.4]])
def test_unlike_workers_come_to_the_end_together(speeds):
    total = 8000
    _, free = dealt_by_workers(total, speeds)
    best = total / sum(1.0 / each for each in speeds)
    assert max(free) < 1.03 * best


def test_tasks_take_about_as_long_as_they_should():
    dealt, _ = dealt_by_workers(10_000, [0.1] * 2)
    usual = sorted(each.count for each in dealt)[-3] * 0.1
    assert 0.5 * TASK_SECONDS <= usual <= TASK_SECONDS
    assert all(each.count * 0.1 >= 0.9 * LEAST_SECONDS for each in dealt[2:-2])


def test_who_is_late_is_told_from_who_has_much_to_do():
    deal = RangeDeal(0, 1000)
    assert not deal.is_late(SampleRange(0, 10), 1e9)  # nobody knows what a sample takes
    deal.note(SampleRange(0, 10), 10.0, 0.0)
    assert not deal.is_late(SampleRange(10, 20), 15.0) and deal.is_late(SampleRange(10, 20), 21.0)
    deal.note(SampleRange(10, 10_010), 0.01, 0.0)
    assert not deal.is_late(SampleRange(20, 21), 0.9 * STRAGGLER_SECONDS)


def test_what_is_rendered_again_is_cut_into_tasks():
    deal = RangeDeal(0, 1000)
    assert deal.cut(SampleRange(3, 40)) == [SampleRange(3, 40)]
    deal.note(SampleRange(0, 10), TASK_SECONDS, 0.0)
    assert deal.cut(SampleRange(3, 27)) == [SampleRange(3, 13), SampleRange(13, 23), SampleRange(23, 27)]


@pytest.mark.parametrize("seed", range(20))
def test_neighbours_are_merged_to_one_film_and_none_often(seed):
    rng = random.Random(seed)
    cuts = sorted({0, 1000, *rng.sample(range(1, 1000), 63)})
    ranges = [SampleRange(a, b) for a, b in itertools.pairwise(cuts)]
    tree, merges = MergeTree(), dict.fromkeys(ranges, 0)
    there: dict[SampleRange, list[SampleRange]] = {}

    def merge(flush):
        while (pair := tree.take_pair(flush)) is not None:
            earlier, later, rank = pair
            assert earlier.end == later.first
            parts = there.pop(earlier) + there.pop(later)
            for each in parts:
                merges[each] += 1
            both = SampleRange(earlier.first, later.end)
            there[both] = parts
            tree.add(both, rank)

    for each in rng.sample(ranges, len(ranges)):
        there[each] = [each]
        tree.add(each)
        merge(False)
    merge(True)
    assert list(there) == [SampleRange(0, 1000)] and there[SampleRange(0, 1000)] == ranges
    assert max(merges.values()) <= 11  # 64 films in any order; 6 where they come in theirs


def test_what_is_fetched_is_not_merged():
    tree = MergeTree()
    tree.add(SampleRange(0, 4))
    tree.add(SampleRange(4, 8))
    tree.remove(SampleRange(0, 4))
    assert tree.take_pair(flush=True) is None


@pytest.mark.parametrize("workers", [1, 3, 40])
@pytest.mark.parametrize("bands", [2, 7])
@pytest.mark.parametrize("total", [1, 5, 1000])
def test_bands_get_all_samples_in_layers(total, bands, workers):
    deal, dealt, ends = RangeDeal(10, 10 + total, bands), [], [10] * bands
    while (samples := deal.next(workers)) is not None:
        dealt.append(samples)
        deal.note(samples, 0.2 * samples.count, 0.1)
        left = total * bands - sum(each.count for each in dealt)
        assert deal.is_dealt == (left == 0) and deal.dealt == pytest.approx(10 + total - left / bands)
    for band in range(bands):
        own = [each for each in dealt if each.band == band]
        assert own[0].first == 10 and own[-1].end == 10 + total
        assert all(a.end == b.first for a, b in itertools.pairwise(own))
    for before, each in itertools.pairwise([SampleRange(10, 10, -1), *dealt]):
        if each.band != before.band and before.band >= 0:  # a layer ends in every band before the next one begins
            assert each.band == (before.band + 1) % bands and (each.band or len(set(ends)) == 1)
        ends[each.band] = each.end
    assert max(each.count for each in dealt) > 1 or total < 10


def test_tasks_are_long_beside_what_their_films_take():
    deal = RangeDeal(0, 100_000)
    deal.note(SampleRange(0, 1000), 100.0, None)  # it builds trees
    assert deal.next(2).count == int(TASK_SECONDS / 0.1)
    for beside in (5.0, 6.0):
        deal.note(SampleRange(0, 1000), 100.0, beside)
    assert deal.next(2).count == int(TASK_TIMES_FILM * 5.0 / 0.1)


def test_layers_of_many_bands_are_not_so_short_that_films_take_most_of_the_time():
    deal = RangeDeal(0, 1000, 32)
    for _ in range(32):
        samples = deal.next(1)
        assert samples.count == 1
        deal.note(samples, 0.5, 0.25)
    assert deal.next(1).count == int(TASK_TIMES_FILM * 0.25 / 0.5)


def test_films_are_merged_up_to_a_border_and_not_beyond():
    tree = MergeTree()
    for first, end, rank in ((0, 1, 0), (1, 9, 3), (9, 12, 3), (12, 20, 1)):
        tree.add(SampleRange(first, end, 1), rank)
        tree.add(SampleRange(first, end, 2), rank)
    tree.add(SampleRange(0, 12, 0))
    assert tree.take_following(0, 3, 12) == []
    merged = []
    while (pair := tree.take_pair()) is not None:
        earlier, later, rank = pair
        assert earlier.band == later.band
        merged.append(SampleRange(earlier.first, later.end, earlier.band))
        tree.add(merged[-1], rank)
    assert {SampleRange(0, 12, 1), SampleRange(0, 12, 2)} <= {*merged} and all(each.end <= 12 for each in merged)
    assert tree.take_pair(flush=True) is None
    assert tree.take_following(0, 3, 20) == [SampleRange(0, 12, each) for each in range(3)]
    assert tree.take_following(0, 3, 20) == []
    tree.add(SampleRange(20, 21, 1))
    assert tree.take_pair(flush=True)[1].first == 20


@pytest.mark.parametrize("seed", range(20))
def test_films_of_all_bands_come_with_the_same_samples_wherever_their_ranges_end(seed):
    """Ranges end elsewhere in each band, tasks and merges end in any order, and films are wanted at any time."""
    rng, bands = random.Random(seed), 3
    deal, tree, first = RangeDeal(0, 400, bands), MergeTree(), 0
    running: list[tuple[SampleRange, int]] = []
    for _ in range(100_000):
        if not deal.is_dealt and rng.random() < 0.5:
            samples = deal.next(rng.randint(1, 5))
            running += [(each, 0) for each in (deal.cut(samples) if rng.random() < 0.2 else [samples])]
        elif running and rng.random() < 0.8:
            samples, rank = running.pop(rng.randrange(len(running)))
            deal.note(samples, rng.uniform(0.5, 3.0) * samples.count, 0.1)
            tree.add(samples, rank)
        while (pair := tree.take_pair(deal.is_dealt and not running)) is not None:
            running.append((dataclasses.replace(pair[0], end=pair[1].end), pair[2]))
        if (deal.is_dealt and not running) or rng.random() < 0.1:
            taken = tree.take_following(first, bands, deal.layer_end)
            assert len({each.end for each in taken}) <= 1 and len(taken) in (0, bands)
            first = taken[0].end if taken else first
        if first == 400:
            return
    pytest.fail(f"nothing comes behind sample {first}")
