"""Rays that visit quantised trees treelet by treelet find what they find in the uncut tree, to the bit, in whatever
order.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.counts import TraceCounts
from raybatch_addon.core.bvh.traverse.cuda_visit import quantised_visit_source
from raybatch_addon.core.bvh.traverse.options import TopLevelTraversal, VisitOptions
from raybatch_addon.core.bvh.traverse.task import VisitTask
from raybatch_addon.core.bvh.tree import DONE, TRAIL_LEVELS, Treelets
from raybatch_addon.core.bvh.treelets.tree import cut_scene_tree
from raybatch_addon.core.rays import NO_ANY_HIT, RayList
from raybatch_addon.core.wavefront.plan.launch import Launch
from tests.core.bvh.traverse.visit_journeys import Journey, check_same, expected_hits, stage_of, start, whole_stage
from tests.core.bvh.traverse.visit_scenes import CASES, RULES, case, cut, make_rays, t_max_of, uploaded
from tests.support.running.shares import each_of
from tests.support.under_test import DEVICE

COUNTS = ("node_steps", "box_tests", "triangle_tests", "treelet_visits", "queued")


@pytest.mark.parametrize("rule", each_of(2, RULES))
@pytest.mark.parametrize("name", CASES)
def test_top_level_and_treelets_in_turn(device, name, rule):
    journey, expected, t_max = start(name, rule, device)
    visits = journey.alternate(np.random.default_rng(1))
    check_same(journey.rays, expected, journey.any_first, t_max)
    assert journey.visits() == visits > 0


@pytest.mark.parametrize("rule", each_of(2, RULES))
@pytest.mark.parametrize("name", CASES)
def test_going_on_through_what_is_there(device, name, rule):
    journey, expected, t_max = start(name, rule, device)
    journey.go_on(np.random.default_rng(2), 0.4, 0.5)
    check_same(journey.rays, expected, journey.any_first, t_max)
    # all there: one launch, and no more visits than treelets that a ray meets
    whole, _, _ = start(name, rule, device)
    whole.run(VisitTask.GO_ON, np.arange(len(t_max)))
    assert (whole.where == DONE).all()
    check_same(whole.rays, expected, whole.any_first, t_max)
    assert whole.visits() > 0


def test_the_cases_are_what_they_should_be(device):
    """Trails of more than one and more than two words; hits in each case; treelets that some rays come to and others do
    not.
    """
    if device == "cpu":  # builders of other devices make other trees
        assert cut("deep", "each node", device).levels > 2 * TRAIL_LEVELS
        assert cut("deep top", "each node", device).levels > cut("deep top", "one", device).levels > TRAIL_LEVELS
    for name in CASES:
        hits = expected_hits(case(name, device), device, t_max_of(len(case(name, device).origin), 4), NO_ANY_HIT)
        assert 0.02 < (hits["hit_instance"] >= 0).mean() < 0.98, name
    everywhere = expected_hits(case("instances", device), device, np.full(800, np.inf, np.float32), NO_ANY_HIT)
    assert len(np.unique(everywhere["hit_instance"])) > 20


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
)
def test_the_order_of_visits_changes_nothing(name, rule, seed, any_share, there, nodes_there, shared_t, in_turn):
    count = len(case(name, DEVICE).origin)
    journey, expected, t_max = start(name, rule, DEVICE, int(any_share * count), shared_t)
    rng = np.random.default_rng(seed)
    if in_turn:
        journey.alternate(rng)
    else:
        journey.go_on(rng, there, nodes_there)
    check_same(journey.rays, expected, journey.any_first, t_max)


def test_only_listed_rays_are_touched(device):
    made = case("soup", device)
    t_max = np.full(len(made.origin), np.inf, np.float32)
    journey = Journey(cut("soup", "nodes", device), make_rays(made, device, t_max), NO_ANY_HIT)
    slots = np.arange(5, 400, 3)
    journey.where[slots[::2]] = DONE
    journey.run(VisitTask.GO_ON, slots)
    fresh = slots[1::2]
    assert (journey.where[slots] == DONE).all()
    others = np.setdiff1d(np.arange(len(t_max)), fresh)
    assert (journey.rays.hit_instance.numpy()[others] == 77).all() and (
        journey.rays.hit_instance.numpy()[fresh] != 77
    ).all()
    journey.run(VisitTask.TOP, np.arange(0))


@pytest.mark.parametrize("name", ("soup", "instances"))
def test_empty_scenes(device, name):
    made = cut(name, "nodes", device)
    empty = dataclasses.replace(made, tree=type(made.tree)())
    for field in made.tree._cls.vars:
        setattr(empty.tree, field, getattr(made.tree, field))
    empty.tree.entry_count = 0
    t_max = np.full(len(case(name, device).origin), 5.0, np.float32)
    for task in (VisitTask.TOP, VisitTask.GO_ON):
        journey = Journey(empty, make_rays(case(name, device), device, t_max), 300)
        journey.run(task, np.arange(len(t_max)))
        assert (journey.where == DONE).all() and (journey.rays.hit_instance.numpy() == -1).all()
        assert (journey.rays.hit_t.numpy()[:300] == 5.0).all() and (
            journey.rays.hit_primitive.numpy()[:300] == -1
        ).all()


@pytest.mark.parametrize("name", ("soup", "instances"))
def test_nodes_alone_let_rays_pass_that_need_no_triangle(device, name):
    """With all nodes and no triangles, rays end that meet no leaf; the others wait, and nothing counts as a visit."""
    journey, expected, _ = start(name, "nodes", device, NO_ANY_HIT, False)
    bare, _, _ = start(name, "nodes", device, NO_ANY_HIT, False)
    made, everyone = journey.made, np.arange(len(journey.where))
    treelets = Treelets()
    treelets.of_node, treelets.root, treelets.nodes = made.treelets.of_node, made.treelets.root, made.treelets.nodes
    treelets.triangles = wp.zeros_like(made.treelets.triangles)
    journey.run(VisitTask.GO_ON, everyone, treelets)
    treelets.nodes = wp.zeros_like(treelets.nodes)
    bare.run(VisitTask.GO_ON, everyone, treelets)
    done, done_bare = journey.where == DONE, bare.where == DONE
    assert journey.visits() == bare.visits() == 0
    assert (done_bare <= done).all() and done_bare.sum() < done.sum() < len(done)
    assert (expected["hit_instance"][done] == -1).all()
    again = journey.where.copy()
    journey.run(VisitTask.GO_ON, everyone, treelets)  # nothing there: all come out as they went in
    assert np.array_equal(journey.where, again)


def counted(count: int, device: str) -> TraceCounts:
    counts = TraceCounts()
    for name in COUNTS:
        setattr(counts, name, wp.full(count, -9, dtype=int, device=device))
    counts.lanes = wp.zeros(6, dtype=wp.int64, device=device)
    return counts


@pytest.mark.parametrize("name", each_of(2, ("instances", "soup")))
def test_counters(device, name):
    count = len(case(name, device).origin)
    journey, expected, t_max = start(name, "nodes", device, NO_ANY_HIT, counts=counted(count, device))
    journey.alternate(np.random.default_rng(3))
    check_same(journey.rays, expected, NO_ANY_HIT, t_max)
    made = {name: getattr(journey.counts, name).numpy() for name in COUNTS}
    assert made["treelet_visits"].sum() == journey.visits() > 0
    assert np.array_equal(made["queued"], 2 * made["treelet_visits"])  # before each treelet and behind it
    # with all there in one launch: the steps of the uncut tree, but where triangles of an earlier part are tested
    # sooner
    whole, _, _ = start(name, "nodes", device, NO_ANY_HIT, counts=counted(count, device))
    whole.run(VisitTask.GO_ON, np.arange(count))
    uncut = counted(count, device)
    rays = make_rays(case(name, device), device, t_max)
    listed = RayList(uploaded(np.arange(count), device), uploaded([count], device), count)
    whole_stage(False, journey.made.instancing, True).launch(case(name, device).built.tree, rays, listed, uncut)
    steps, steps_uncut = whole.counts.node_steps.numpy().sum(), uncut.node_steps.numpy().sum()
    assert 0.8 * steps_uncut < steps <= steps_uncut
    assert steps <= made["node_steps"].sum()
    assert whole.counts.queued.numpy().sum() == 0 and np.array_equal(
        whole.counts.treelet_visits.numpy() > 0, made["treelet_visits"] > 0
    )
    lanes = whole.counts.lanes.numpy()
    assert lanes[2] == steps and (lanes[::2] <= lanes[1::2]).all()


LAUNCHES = (
    Launch(single_lane=True),
    Launch(warp_count=3, block_size=64),
    Launch(register_cap=64, block_size=1024),
    Launch(warp_count=1),
)


@pytest.mark.parametrize("launch", LAUNCHES, ids=str)
@pytest.mark.parametrize("name", each_of(2, ("instances", "soup")))
def test_launch_settings_change_no_hit(device, name, launch):
    journey, expected, t_max = start(name, "nodes", device, launch=launch, top_level=TopLevelTraversal.INTERLOCKED)
    journey.alternate(np.random.default_rng(4))
    check_same(journey.rays, expected, journey.any_first, t_max)
    whole, _, _ = start(name, "nodes", device, launch=launch)
    whole.go_on(np.random.default_rng(4), 0.5, 0.5)
    check_same(whole.rays, expected, whole.any_first, t_max)
    made = case(name, device)
    rays = make_rays(made, device, t_max)
    count = len(t_max)
    listed = RayList(uploaded(np.arange(count), device), uploaded([count], device), count)
    whole_stage(False, made.instancing, launch=launch).launch(made.built.tree, rays, listed, None)
    closest = expected_hits(made, device, t_max, NO_ANY_HIT)
    check_same(rays, closest, NO_ANY_HIT, t_max)


@pytest.mark.skipif(DEVICE != "cpu", reason="the layout of CPUs")
@pytest.mark.parametrize("launch", (Launch(single_lane=True), Launch(warp_count=7), Launch(warp_count=1000)), ids=str)
def test_launch_settings_on_the_cpu(device, launch):
    """BOXES: slices of the list, and one ray at a time."""
    made = case("instances", device, Layout.BOXES)
    count, any_first = len(made.origin), 500
    t_max = t_max_of(count, 4)
    expected = expected_hits(made, device, t_max, any_first)
    made_cut = cut_scene_tree(made.built, RULES["nodes"], wp.get_device(device))
    journey = Journey(made_cut, make_rays(made, device, t_max), any_first, launch=launch)
    journey.go_on(np.random.default_rng(5), 0.5, 0.5)
    check_same(journey.rays, expected, any_first, t_max)
    rays = make_rays(made, device, t_max)
    for any_hit, part in ((False, np.arange(any_first)), (True, np.arange(any_first, count))):
        listed = RayList(uploaded(part, device), uploaded([len(part)], device), len(part))
        whole_stage(any_hit, True, launch=launch, layout=Layout.BOXES).launch(made.built.tree, rays, listed, None)
    check_same(rays, expected, any_first, t_max)


def test_capped_kernels_are_kernels_of_their_own():
    plain, capped = (stage_of(VisitTask.TOP, False, launch=Launch(register_cap=cap)).kernels[0] for cap in (0, 72))
    assert (
        capped is not plain and capped.options["cuda_max_registers"] == 72 and "cuda_max_registers" not in plain.options
    )
    off, off_capped = (whole_stage(False, False, launch=Launch(register_cap=cap)).kernels[0] for cap in (0, 72))
    assert off_capped.options["cuda_max_registers"] == 72 and "cuda_max_registers" not in off.options


def test_tasks_are_compiled_apart():
    made = [
        VisitOptions(task=task, instancing=instancing, refill=refill)
        for task in VisitTask
        for instancing in (False, True)
        for refill in (8, 32)
    ]
    assert len({quantised_visit_source(options) for options in made}) == 12
    with pytest.raises(ValueError, match="refill"):
        VisitOptions(task=VisitTask.TOP, instancing=False, refill=0)
