"""Counts of batching, added up over workers and reported."""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np

from raybatch_addon.core.measure.batching import (
    OCCUPANCY_POINTS,
    TOP_LEVEL_TOTALS,
    BatchingTotals,
    PageWaits,
    batching_statistics,
)

ONE = BatchingTotals(
    rays=10,
    finished=8,
    treelet_visits=28,
    rays_queued=20,
    steps=3,
    blocks_peak=5,
    block_count=7,
    blocks_short=1,
    wait_max=9,
    rays_unbatched=2,
    bytes_copied=1000,
    pages_loaded=4,
    pages_evicted=3,
    resident_peak=500,
    occupancy=[(0.5, 4)],
)
OTHER = BatchingTotals(
    rays=1, finished=1, treelet_visits=2, blocks_peak=6, wait_max=4, resident_peak=600, occupancy=[(0.1, 1), (0.2, 0)]
)


def test_workers_together():
    both = ONE.merge(OTHER)
    assert both == OTHER.merge(ONE)
    assert (both.rays, both.finished, both.treelet_visits, both.blocks_peak, both.pages_loaded) == (11, 9, 30, 11, 4)
    assert (both.wait_max, both.resident_peak) == (9, 600) and both.occupancy == OTHER.occupancy
    assert ONE.merge(BatchingTotals()) == ONE


def test_totals_stand_at_the_top_and_all_in_an_object_of_their_own():
    auto = {"treelet_size": {"value": 800, "why": "a treelet of this size fits the cache"}}
    reported = batching_statistics(ONE, auto)
    assert json.loads(json.dumps(reported)) == reported
    assert {name: reported[name] for name in TOP_LEVEL_TOTALS} == {
        name: getattr(ONE, name) for name in TOP_LEVEL_TOTALS
    }
    assert set(TOP_LEVEL_TOTALS) | {"batching", "auto"} == set(reported) and reported["auto"] == auto
    assert {each.name for each in fields(ONE)} < set(reported["batching"])
    assert reported["batching"]["occupancy"] == [[0.5, 4]]
    means = {name: value for name, value in reported["batching"].items() if name.endswith("_per_ray")}
    assert means == {"treelet_visits_per_ray": 3.5, "rays_queued_per_ray": 2.5, "bytes_copied_per_ray": 125.0}
    assert not batching_statistics(BatchingTotals(), {})["batching"]["treelet_visits_per_ray"], "a render of nothing"


def test_a_render_that_does_not_batch_says_zero():
    reported = batching_statistics(None, {})
    assert (
        all(reported[name] == 0 for name in TOP_LEVEL_TOTALS)
        and reported["batching"] is None
        and reported["auto"] == {}
    )


def test_all_of_it_is_documented():
    text = (Path(__file__).resolve().parents[3] / "docs/statistics.md").read_text(encoding="utf-8")
    reported = batching_statistics(ONE, {})
    for name in (*reported, *reported["batching"]):
        assert f"`{name}`" in text, name


def test_occupancy_is_thinned_out():
    totals = BatchingTotals()
    for i in range(10 * OCCUPANCY_POINTS):
        totals.note_occupancy(i / 3, i)
        assert len(totals.occupancy) <= OCCUPANCY_POINTS
    assert totals.occupancy[0] == (0.0, 0) and totals.occupancy[-1][1] > 9 * OCCUPANCY_POINTS


def test_a_ray_waits_for_a_page_as_long_as_it_is_not_taken():
    waits = PageWaits(2)
    nothing, both = np.zeros(0, int), np.arange(2)
    waits.note(3, np.array([5, 0]), both)
    for step in (4, 5):
        waits.note(step, np.array([6, 1]), nothing)  # the pages are not there
        assert waits.longest == 0
    waits.note(6, np.array([0, 1]), np.array([0]))
    assert waits.longest == 3
    waits.note(9, np.array([0, 0]), nothing)  # taken all the same, as a full batch may
    assert waits.longest == 5


def test_rays_that_follow_others_to_a_page_have_not_waited_for_them():
    """A page that is never without rays, and whose rays are taken in every step."""
    waits = PageWaits(1)
    for step in range(20):
        waits.note(step, np.array([4]), np.array([0]))
    assert waits.longest == 1
    waits.forget()
    waits.note(40, np.array([4]), np.array([0]))
    assert waits.longest == 1
