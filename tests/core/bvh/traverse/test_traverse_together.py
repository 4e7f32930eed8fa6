"""Warps whose rays go through the top level together (SHORT_SEGMENT, LONG_HAUL). A CPU lets lanes take turns, in the
kernels that CUDA runs, with the same votes.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.traverse.counts import TraceCounts
from raybatch_addon.core.bvh.traverse.cuda_visit import quantised_visit_source
from raybatch_addon.core.bvh.traverse.options import TopLevelTraversal, VisitOptions
from raybatch_addon.core.bvh.traverse.task import VisitTask
from raybatch_addon.core.bvh.tree import DONE, NEW
from raybatch_addon.core.bvh.treelets.cut import CutRule
from raybatch_addon.core.bvh.treelets.tree import cut_scene_tree
from raybatch_addon.core.rays import NO_ANY_HIT
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.wavefront.tracers.visit import quantised_visit_kernel
from tests.core.bvh.traverse.visit_journeys import Journey, check_same, start
from tests.core.bvh.traverse.visit_scenes import CASES, RULES, Case, case, cut, make_rays, of_objects
from tests.support import scenes
from tests.support.running.shares import each_of
from tests.support.under_test import DEVICE
from tests.support.wide_trees import soup

on_a_cpu = pytest.mark.skipif(DEVICE != "cpu", reason="lanes that take turns are of CPUs")

COUNTS = ("node_steps", "box_tests", "triangle_tests", "treelet_visits", "queued")
SHORT, LONG, NAIVE = TopLevelTraversal.SHORT_SEGMENT, TopLevelTraversal.LONG_HAUL, TopLevelTraversal.NAIVE
# On a CPU kernels are few: with instancing one has as many lanes as a warp, and the other few; without vice versa
LANES = {(SHORT, True): 5, (LONG, True): 32, (SHORT, False): 32, (LONG, False): 5} if DEVICE == "cpu" else {}


def counted(count: int) -> TraceCounts:
    counts = TraceCounts()
    for name in COUNTS:
        setattr(counts, name, wp.zeros(count, dtype=int, device=DEVICE))
    counts.lanes = wp.zeros(7, dtype=wp.int64, device=DEVICE)
    return counts


@functools.cache
def travelled(name: str, rule: str, top_level: TopLevelTraversal) -> tuple[dict[str, np.ndarray], int]:
    """Counts of rays that were traced as they should be, and how often one passed a treelet that others entered."""
    counts = counted(len(case(name, DEVICE).origin))
    lanes = LANES.get((top_level, cut(name, rule, DEVICE).instancing), 1)
    journey, expected, t_max = start(name, rule, DEVICE, counts=counts, top_level=top_level, lanes=lanes)
    journey.alternate(np.random.default_rng(3))
    check_same(journey.rays, expected, journey.any_first, t_max)
    return {field: getattr(counts, field).numpy().copy() for field in COUNTS}, journey.skipped


@pytest.mark.parametrize("rule", each_of(3, RULES))
@pytest.mark.parametrize("name", CASES)
def test_each_ray_visits_what_it_visits_alone(name, rule):
    """Hits to the bit, and each ray the same treelets. Those that others enter cost nodes, on the way down the trail
    again, and waits, but no triangle; and a ray that is carried along visits nothing that it does not want.
    """
    (alone, _), (long, none), (short, skipped) = (travelled(name, rule, each) for each in (NAIVE, LONG, SHORT))
    assert np.array_equal(long["treelet_visits"], alone["treelet_visits"])
    assert np.array_equal(long["queued"], alone["queued"])
    # NAIVE rays visit nodes while triangles wait
    assert long["node_steps"].sum() <= alone["node_steps"].sum()
    # the nodes of `deep` lie within each other, and rays come to one after another
    assert none == 0
    if DEVICE == "cpu":  # builders of other devices make other trees
        assert (skipped > 0) == (cut(name, rule, DEVICE).levels > 1 and name != "deep")
    assert short["queued"].sum() == long["queued"].sum() + skipped
    assert np.array_equal(short["treelet_visits"], long["treelet_visits"])
    assert np.array_equal(short["triangle_tests"], long["triangle_tests"])
    assert (short["node_steps"].sum() > long["node_steps"].sum()) == (skipped > 0)


@functools.cache
def clouds() -> Case:
    """Eight clouds of triangles side by side, and a ray through the middle of each."""
    parts = [soup(60, seed, 0.2) for seed in range(8)]
    places = np.float32([[4.0 * (i % 2), 4.0 * (i // 2 % 2), 4.0 * (i // 4)] for i in range(8)])
    positions = np.concatenate([0.5 * part[0] + place for part, place in zip(parts, places)])
    faces = np.concatenate([part[1] + 180 * i for i, part in enumerate(parts)])
    rays = places - np.float32([0, 0, 1.5]), np.tile(np.float32([0, 0, 1]), (8, 1))
    return of_objects("cpu", [(Mesh("clouds", positions, faces), [scenes.IDENTITY])], False, rays)


def clouds_visited(top_level: TopLevelTraversal, rays: np.ndarray) -> tuple[int, int, int, int]:
    """With a treelet for each cloud: launches of TOP until `rays` are all through, times that a ray passed a treelet,
    nodes that rays visited above treelets, and nodes that the warp read for them.
    """
    made = cut_scene_tree(clouds().built, CutRule(size=1, depth_max=1), wp.get_device("cpu"))
    assert made.treelet_count == 8
    t_max, counts = np.full(8, 2.5, np.float32), counted(8)
    lanes = LANES[top_level, False]
    journey = Journey(made, make_rays(clouds(), "cpu", t_max), NO_ANY_HIT, counts, top_level=top_level, lanes=lanes)
    launches = nodes = 0
    while (waiting := rays[(journey.where[rays] == NEW) | journey.behind[rays]]).size:
        before = counts.node_steps.numpy().sum()
        journey.run(VisitTask.TOP, waiting)
        nodes += counts.node_steps.numpy().sum() - before
        launches += 1
    assert len(set(journey.where[rays])) == len(rays) and (journey.where[rays] >= 0).all()
    return launches, journey.skipped, int(nodes), int(counts.lanes.numpy()[6])


@on_a_cpu
def test_a_segment_ends_where_a_ray_enters_a_treelet():
    """Rays that part at the root. SHORT_SEGMENT brings one of them to its treelet in each launch, and the others come
    to the root again; LONG_HAUL brings each, one after another, and reads the root once for all lanes of a warp.
    """
    rays = np.arange(8)
    assert clouds_visited(SHORT, rays) == (8, 7 * 8 // 2, 8 + 8 * 9 // 2, 8 + 8)
    assert clouds_visited(LONG, rays) == (1, 0, 8 + 8, 2 + 8)  # of 5 lanes: 5 rays, then 3
    assert clouds_visited(SHORT, rays[:1]) == (1, 0, 2, 2)
    assert clouds_visited(LONG, rays[:5]) == (1, 0, 5 + 5, 1 + 5)


@on_a_cpu
def test_rays_that_want_the_same_go_together():
    """A warp of copies of one ray reads what one ray reads, and nobody passes a treelet that it wants."""
    journey, _, t_max = start("deep", "each node", "cpu", NO_ANY_HIT)
    count, one = len(t_max), {}
    for top_level in (SHORT, LONG):
        for copies in (1, 5):
            made, counts = case("deep", "cpu"), counted(count)
            rays = make_rays(made, "cpu", np.full(count, np.inf, np.float32))
            for name in ("origin", "direction"):
                getattr(rays, name).assign(np.tile(getattr(made, name)[7], (count, 1)))
            rays.visibility.fill_(1)
            travel = Journey(journey.made, rays, NO_ANY_HIT, counts, top_level=top_level, lanes=LANES[top_level, False])
            steps = 0
            while (travel.where[:copies] != DONE).any():
                top = (travel.where[0] == NEW) | travel.behind[0]
                travel.run(VisitTask.TOP if top else VisitTask.TREELET, np.arange(copies))
                assert len(set(travel.where[:copies])) == 1 and travel.skipped == 0
                steps += 1
            assert steps > 2
            found = int(counts.lanes.numpy()[6]), steps
            assert one.setdefault(top_level, found) == found


def test_sources():
    """What lanes elect is in TOP of these schedules alone; other kernels keep their text."""
    texts = {
        (task, top_level): quantised_visit_source(VisitOptions(task=task, instancing=True, top_level=top_level))
        for task in VisitTask
        for top_level in TopLevelTraversal
    }
    for (task, top_level), text in texts.items():
        together = task is VisitTask.TOP and top_level in (SHORT, LONG)
        assert ("together/loop.h" in text) == ("find_peers" in text) == together
        assert ("quantised/loop.h" in text) != together
        assert ("together/cut.h" in text) == (task is VisitTask.TOP and top_level is SHORT)
        if task is not VisitTask.TOP:
            assert text == texts[task, NAIVE]
    assert len({texts[VisitTask.TOP, each] for each in TopLevelTraversal}) == 4
    with pytest.raises(ValueError, match="lanes"):
        VisitOptions(task=VisitTask.TOP, instancing=True, lanes=33)


@pytest.mark.parametrize(
    "options",
    (
        VisitOptions(task=VisitTask.TOP, instancing=True, top_level=SHORT, counters=True, curves=True, motion=True),
        VisitOptions(task=VisitTask.TOP, instancing=False, top_level=LONG),
    ),
    ids=("short", "long"),
)
def test_the_source_for_cuda_compiles(options, tmp_path):
    """Also on machines without a device."""
    module = quantised_visit_kernel(options).module
    assert wp.compile_aot_module(module, arch=90, module_dir=tmp_path, use_ptx=True)
