"""Pages are chosen by how many rays wait, and for how long; what makes room is what nobody misses."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.bvh.pages.facts import PageFacts
from raybatch_addon.core.wavefront.tracers.pages.policy import AGE_SWEEPS_MOST, choose_pages, choose_victims, copies_pay


def facts_of(waiting, pool=4, clock=100, **changes) -> PageFacts:
    waiting = np.asarray(waiting, np.int64)
    n = len(waiting)
    facts = PageFacts(
        waiting=waiting,
        since=np.full(n, clock),
        absent=np.ones(n, bool),
        evictable=np.zeros(n, bool),
        loaded_at=np.zeros(n, np.int64),
        left_at=np.zeros(n, np.int64),
        served=np.zeros(n, np.int64),
        clock=clock,
        pool=pool,
    )
    return dataclasses.replace(
        facts,
        **{name: np.asarray(value) if name not in ("clock", "pool") else value for name, value in changes.items()},
    )


def test_most_waiting_first_and_ties_by_number():
    assert choose_pages(facts_of([5, 9, 0, 9, 7]), 3) == [1, 3, 4]


def test_nothing_that_is_there_or_that_nobody_waits_for():
    facts = facts_of([5, 9, 0, 2], absent=[True, False, True, True])
    assert choose_pages(facts, 10) == [0, 3]
    assert choose_pages(facts, 0) == []
    assert choose_pages(facts_of([0, 0]), 2) == []


def test_waiting_long_counts():
    assert choose_pages(facts_of([10, 15], since=[100, 100]), 1) == [1]
    # after four sweeps of two pages a ray counts twice
    assert choose_pages(facts_of([10, 15], since=[92, 100]), 1) == [0]


def test_nobody_waits_for_ever():
    since = [0, 1, 100]
    assert AGE_SWEEPS_MOST < 100 / 3
    assert choose_pages(facts_of([1, 1, 10**9], since=since), 3) == [0, 1, 2]


def test_victims_are_those_that_nobody_waits_for():
    facts = facts_of([0, 3, 0, 1], evictable=[True] * 4, served=[10, 1, 5, 1], loaded_at=[99] * 4)
    assert choose_victims(facts, 4) == [2, 0]
    assert choose_victims(facts, 1) == [2]
    assert choose_victims(facts, 4, forced=True) == [2, 0, 3, 1]
    assert choose_victims(dataclasses.replace(facts, evictable=np.zeros(4, bool)), 4, forced=True) == []


def test_of_pages_wanted_alike_the_oldest_leaves():
    facts = facts_of([0, 0, 0], evictable=[True] * 3, served=[8, 8, 8], loaded_at=[50, 40, 60], left_at=[49, 39, 59])
    assert choose_victims(facts, 3) == [1, 0, 2]


def test_popular_pages_stay():
    # as many waited for both, but for the first they came in a tenth of the time
    facts = facts_of([0, 0], evictable=[True] * 2, served=[100, 100], loaded_at=[90, 95], left_at=[85, 45])
    assert choose_victims(facts, 1) == [1]


def test_every_page_is_served_in_bounded_time():
    """New rays come to a few pages for ever; those that wait at the others are served all the same."""
    n = 20
    waiting, since = np.ones(n, np.int64), np.zeros(n, np.int64)
    served = set()
    for clock in range(int((AGE_SWEEPS_MOST + 2) * n)):
        waiting[:3] += 1000
        page = choose_pages(facts_of(waiting, clock=clock, since=since), 1)[0]
        served.add(page)
        waiting[page], since[page] = 0, clock + 1
        if page >= 3:
            waiting[page], since[page] = 0, clock + 1
    assert served == set(range(n))


@pytest.mark.parametrize("nodes_there, fewest", [(False, 9_192), (True, 22_108)])
def test_few_rays_are_not_worth_a_copy(nodes_there, fewest):
    page = 64_000_000
    assert not copies_pay(fewest, page, nodes_there)
    assert copies_pay(fewest + 2, page, nodes_there)
    assert not copies_pay(0, 1, nodes_there)
