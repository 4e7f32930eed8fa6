"""Rays that visit trees of BOXES treelet by treelet find what they find in the uncut tree, to the bit, in whatever
order.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from raybatch_addon.core.bvh.traverse.counts import TraceCounts
from raybatch_addon.core.bvh.traverse.cpu import traversal_source
from raybatch_addon.core.bvh.traverse.cpu_visit import boxes_visit_source
from raybatch_addon.core.bvh.traverse.options import TopLevelTraversal, TraceOptions, VisitOptions
from raybatch_addon.core.bvh.traverse.task import VisitTask
from raybatch_addon.core.bvh.tree import DONE, NEW, TRAIL_LEVELS, Tree, Treelets
from raybatch_addon.core.wavefront.tracers.unbatched import boxes_kernel
from tests.core.bvh.traverse.cpu_visit_journeys import COUNTED, Journey, expected_hits
from tests.core.bvh.traverse.cpu_visit_scenes import CASES, NO_ANY_HIT, RULES, case, cut, list_of, make_rays, t_max_of
from tests.support.running.shares import each_of


@pytest.mark.parametrize("rule", each_of(2, RULES))
@pytest.mark.parametrize("name", CASES)
def test_top_level_and_treelets_in_turn(name, rule):
    journey = Journey(name, rule)
    assert journey.alternate(np.random.default_rng(1)) == journey.visits() > 0
    journey.check()


@pytest.mark.parametrize("rule", each_of(2, RULES))
@pytest.mark.parametrize("name", CASES)
def test_going_on_through_what_is_there(name, rule):
    journey = Journey(name, rule)
    journey.go_on(np.random.default_rng(2), 0.4, 0.5)
    journey.check()
    whole = Journey(name, rule)  # all there: one launch
    whole.run(VisitTask.GO_ON, np.arange(len(whole.where)))
    whole.check()
    assert whole.visits() > 0


def test_the_cases_are_what_they_should_be():
    assert cut("deep", "each node").levels > 2 * TRAIL_LEVELS
    assert cut("deep top", "one").levels > TRAIL_LEVELS and cut("deep top", "each node").levels > 2 * TRAIL_LEVELS
    for name in CASES:
        hits = expected_hits(name, NO_ANY_HIT)
        assert 0.02 < (hits["hit_instance"] >= 0).mean() < 0.98, name
    assert len(np.unique(expected_hits("instances", NO_ANY_HIT)["hit_instance"])) > 20
    for name in ("soup", "deep", "instances"):
        assert cut(name, "each node").mesh_triangle[-1] > 0  # leaves above treelets


@settings(max_examples=25, deadline=None)
@given(
    name=st.sampled_from(CASES),
    rule=st.sampled_from(list(RULES)),
    seed=st.integers(0, 1000),
    any_share=st.floats(0, 1),
    there=st.floats(0, 1),
    nodes_there=st.floats(0, 1),
    shared_t=st.booleans(),
    in_turn=st.booleans(),
    interlocked=st.booleans(),
)
def test_the_order_of_visits_changes_nothing(
    name, rule, seed, any_share, there, nodes_there, shared_t, in_turn, interlocked
):
    journey = Journey(
        name, rule, int(any_share * len(case(name).origin)), shared_t, interlocked=interlocked and in_turn
    )
    rng = np.random.default_rng(seed)
    if in_turn:
        journey.alternate(rng)
    else:
        journey.go_on(rng, there, nodes_there)
    journey.check()


@pytest.mark.parametrize("interleave", each_of(2, [3, 1]))
@pytest.mark.parametrize("name", each_of(2, ["instances", "soup"]))
def test_how_many_rays_are_carried_changes_nothing(name, interleave):
    for in_turn in (True, False):
        journey, rng = Journey(name, "nodes", interleave=interleave), np.random.default_rng(3)
        journey.alternate(rng) if in_turn else journey.go_on(rng, 0.5, 0.5)
        journey.check()


def test_rays_that_are_not_in_the_batch_or_done_are_left_alone():
    journey = Journey("soup", "nodes", NO_ANY_HIT, False)
    slots = np.arange(5, 400, 3)
    journey.where[slots[::2]] = DONE
    journey.run(VisitTask.GO_ON, slots)
    assert (journey.where[slots] == DONE).all()
    primitive = journey.rays.hit_primitive.numpy()
    assert (np.delete(primitive, slots[1::2]) == -77).all() and (primitive[slots[1::2]] != -77).all()
    for task in VisitTask:
        journey.run(task, np.arange(0))
    journey.where[:50] = NEW
    journey.run(VisitTask.TREELET, np.arange(50))  # these wait at none
    assert (journey.where[:50] == NEW).all()


@pytest.mark.parametrize("task", [VisitTask.TOP, VisitTask.GO_ON])
@pytest.mark.parametrize("name", ["soup", "instances"])
def test_a_scene_without_entries_is_missed(name, task):
    journey = Journey(name, "nodes", 300, False)
    tree = Tree()
    journey.made = dataclasses.replace(journey.made, tree=tree, treelets=Treelets())
    journey.run(task, np.arange(len(journey.where)))
    assert (journey.where == DONE).all() and (journey.rays.hit_instance.numpy() == -1).all()
    limit = t_max_of(name)[:300]
    assert (
        np.array_equal(journey.rays.hit_t.numpy()[:300], np.where(limit > 0, limit, 0))
        and (journey.rays.hit_primitive.numpy()[:300] == -1).all()
    )


@pytest.mark.parametrize("name", ["soup", "instances"])
def test_nodes_alone_let_rays_pass_that_need_no_triangle(name):
    """With all nodes and no triangles, rays end that meet no leaf; the others wait, and nothing counts as a visit."""
    journey, bare = Journey(name, "nodes", NO_ANY_HIT), Journey(name, "nodes", NO_ANY_HIT)
    everyone, total = np.arange(len(journey.where)), journey.made.treelet_count
    journey.run(VisitTask.GO_ON, everyone, journey.treelets(np.ones(total, bool), np.zeros(total, bool)))
    nothing = journey.treelets(np.zeros(total, bool), np.zeros(total, bool))
    bare.run(VisitTask.GO_ON, everyone, nothing)
    done, done_bare = journey.where == DONE, bare.where == DONE
    assert journey.visits() == bare.visits() == 0
    assert (done_bare <= done).all() and done_bare.sum() < done.sum() < len(done)
    again = journey.where.copy()
    journey.run(VisitTask.GO_ON, everyone, nothing)  # all come out as they went in
    assert np.array_equal(journey.where, again)
    journey.run(VisitTask.GO_ON, everyone)
    journey.check()


@pytest.mark.parametrize("name", each_of(2, ["instances", "soup"]))
def test_counters(name):
    journey, whole = (Journey(name, "nodes", NO_ANY_HIT, counted=True) for _ in range(2))
    journey.alternate(np.random.default_rng(3))
    journey.check()
    whole.run(VisitTask.GO_ON, np.arange(len(whole.where)))
    whole.check()
    found, at_once = ({field: getattr(j.counts, field).numpy() for field in COUNTED} for j in (journey, whole))
    assert found["treelet_visits"].sum() == journey.visits() and at_once["treelet_visits"].sum() == whole.visits() > 0
    assert np.array_equal(found["queued"], 2 * found["treelet_visits"])  # before each treelet and behind it
    assert not at_once["queued"].any()
    # the same steps as in the uncut tree when all is there, since it is visited in the same order
    rays, uncut, count = make_rays(name), TraceCounts(), len(whole.where)
    for field in COUNTED[:3]:
        setattr(uncut, field, wp.zeros(count, dtype=int, device="cpu"))
    kernel = boxes_kernel(TraceOptions(any_hit=False, instancing=whole.made.instancing, counters=True))
    inputs = [case(name).built.tree, rays, list_of(np.arange(count)), 1, uncut]
    wp.launch(kernel, 1, inputs, device="cpu")
    for field in COUNTED[:3]:
        assert np.array_equal(at_once[field], getattr(uncut, field).numpy()), field
        assert (found[field] >= at_once[field]).all()


def test_sources():
    """Each task is compiled for itself, for CPUs alone, and whole trees have no step of it."""
    texts = [
        boxes_visit_source(VisitOptions(task=task, instancing=instancing, top_level=together))
        for task in VisitTask
        for instancing in (False, True)
        for together in (TopLevelTraversal.NAIVE, TopLevelTraversal.INTERLOCKED)
    ]
    assert len(set(texts)) == 8  # rays are taken together in TOP alone
    for text in texts:
        assert text.strip().startswith("#if !defined(__CUDA_ARCH__)") and text.strip().endswith("#endif")
        assert "#define TREELETS 1" in text and "boxes/visit.h" in text
    for any_hit in (False, True):
        text = traversal_source(TraceOptions(any_hit=any_hit, instancing=True))
        assert "#define TREELETS 0" in text and "boxes/visit" not in text
