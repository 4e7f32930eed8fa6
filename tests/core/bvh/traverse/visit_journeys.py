"""Rays that visit the treelets of a quantised tree in orders at random."""

from __future__ import annotations

import functools

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.traverse.options import TopLevelTraversal, TraceOptions, VisitOptions
from raybatch_addon.core.bvh.traverse.task import VisitTask
from raybatch_addon.core.bvh.tree import DONE, NEW, TRAIL_LEVELS, TopProgress, Treelets
from raybatch_addon.core.bvh.treelets.tree import TreeletTree
from raybatch_addon.core.rays import RayList, Rays
from raybatch_addon.core.wavefront.plan.launch import Launch
from raybatch_addon.core.wavefront.tracers.unbatched import trace_stage
from raybatch_addon.core.wavefront.tracers.visit import visit_stage
from tests.core.bvh.traverse.visit_scenes import Case, case, cut, make_rays, t_max_of, uploaded

HITS = ("hit_t", "hit_instance", "hit_primitive", "hit_uv")


@functools.cache
def stage_of(
    task: VisitTask,
    instancing: bool,
    counters: bool = False,
    top_level: TopLevelTraversal = TopLevelTraversal.NAIVE,
    launch: Launch = Launch(),
    layout: Layout = Layout.QUANTISED,
    lanes: int = 1,
):
    options = VisitOptions(task=task, instancing=instancing, counters=counters, top_level=top_level, lanes=lanes)
    return visit_stage(layout, options, launch)


@functools.cache
def whole_stage(
    any_hit: bool,
    instancing: bool,
    counters: bool = False,
    launch: Launch = Launch(),
    layout: Layout = Layout.QUANTISED,
):
    return trace_stage(layout, TraceOptions(any_hit=any_hit, instancing=instancing, counters=counters), launch)


def expected_hits(made: Case, device: str, t_max: np.ndarray, any_first: int) -> dict[str, np.ndarray]:
    """By the unbatched traversal of the uncut tree."""
    rays = make_rays(made, device, t_max)
    slots = np.arange(len(t_max))
    for any_hit, part in ((False, slots[slots < any_first]), (True, slots[slots >= any_first])):
        listed = RayList(uploaded(part, device), uploaded([len(part)], device), len(part))
        whole_stage(any_hit, made.instancing, layout=made.built.layout).launch(made.built.tree, rays, listed, None)
    return {name: getattr(rays, name).numpy() for name in HITS}


def check_same(rays: Rays, expected: dict[str, np.ndarray], any_first: int, t_max: np.ndarray) -> None:
    """All hits, to the bit; of any-hit rays whether there is one, and that their `t_max` is as it was."""
    for name in HITS:
        found = getattr(rays, name).numpy()[:any_first]
        assert np.array_equal(found.view(np.uint32), expected[name][:any_first].view(np.uint32)), name
    assert np.array_equal(rays.hit_instance.numpy()[any_first:], expected["hit_instance"][any_first:])
    assert np.array_equal(rays.t_max.numpy()[any_first:].view(np.uint32), t_max[any_first:].view(np.uint32))


class Journey:
    """Rays on their way through a cut tree: where each waits, on the host."""

    def __init__(
        self,
        made: TreeletTree,
        rays: Rays,
        any_first: int,
        counts=None,
        launch: Launch = Launch(),
        top_level: TopLevelTraversal = TopLevelTraversal.NAIVE,
        lanes: int = 1,
    ):
        self.made, self.rays, self.any_first, self.counts = made, rays, any_first, counts
        self.launch, self.top_level, self.lanes = launch, top_level, lanes
        self.device, count = rays.origin.device, rays.origin.shape[0]
        self.progress = TopProgress()
        words = -(-made.levels // TRAIL_LEVELS)
        self.progress.trail = wp.full((words, count), 0xFFFFFFFF, dtype=wp.uint32, device=self.device)
        self.progress.entry = wp.full(count if made.instancing else 0, -5, dtype=int, device=self.device)
        self.progress.visits = wp.zeros(1, dtype=wp.int64, device=self.device)
        self.where = np.full(count, NEW, np.int32)
        # the ray is through with the treelet that it waits at, or has passed it (SHORT_SEGMENT)
        self.behind = np.zeros(count, bool)
        self.skipped = 0  # times that a ray passed the treelet at which it waits

    def run(self, task: VisitTask, slots: np.ndarray, treelets: Treelets | None = None) -> None:
        """`task` for the rays in `slots`."""
        where = uploaded(self.where[slots], self.device)
        batch = RayList(uploaded(slots, self.device), uploaded([len(slots)], self.device), len(slots), where)
        top = (
            (self.top_level, self.launch, self.made.layout, self.lanes)
            if task is VisitTask.TOP
            else (TopLevelTraversal.NAIVE, self.launch, self.made.layout)
        )
        stage = stage_of(task, self.made.instancing, self.counts is not None, *top)
        stage.launch(
            self.made.tree, treelets or self.made.treelets, self.rays, self.progress, batch, self.any_first, self.counts
        )
        came = where.numpy()[: len(slots)].copy()
        if stage.writes_queues:
            is_behind = (came >= 0) & (came % 2 == 1)
            came = np.where(came >= 0, came // 2, came)
            self.skipped += int(is_behind.sum())
        else:
            is_behind = np.full(len(slots), task is VisitTask.TREELET)
        self.where[slots], self.behind[slots] = came, is_behind

    def visits(self) -> int:
        return int(self.progress.visits.numpy()[0])

    def alternate(self, rng: np.random.Generator) -> int:
        """Top level and treelets in turn, rays in batches at random, until all are done; how many visits there should
        have been.
        """
        visits = 0
        for _ in range(100_000):
            alive = np.flatnonzero(self.where != DONE)
            if len(alive) == 0:
                return visits
            chosen = rng.permutation(alive)[: rng.integers(1, 2 * len(alive) + 2)]
            entering = chosen[(self.where[chosen] >= 0) & ~self.behind[chosen]]
            going_on = np.setdiff1d(chosen, entering)
            if len(entering):
                before = self.where[entering]
                self.run(VisitTask.TREELET, entering)
                assert ((self.where[entering] == DONE) | (self.where[entering] == before)).all()
                assert (self.where[entering[entering < self.any_first]] != DONE).all()
                visits += len(entering)
            if len(going_on):
                before = self.where[going_on]
                self.run(VisitTask.TOP, rng.permutation(going_on))
                assert (self.where[going_on] != NEW).all()
                again = self.where[going_on] == before  # another instance, or a treelet that was passed
                assert self.made.instancing or self.top_level is TopLevelTraversal.SHORT_SEGMENT or not again.any()
                # of the rays that a warp takes at least one comes to the end of its way through the top level
                lanes = 32 if self.device.is_cuda else self.lanes
                assert self.behind[going_on].sum() <= len(going_on) - -(-len(going_on) // lanes)
        raise AssertionError("rays never end")

    def go_on(self, rng: np.random.Generator, there: float, nodes_there: float) -> None:
        """`GO_ON` with another choice of treelets there each time, until all rays are done."""
        total = self.made.treelet_count
        tables = {name: getattr(self.made.treelets, name).numpy() for name in ("nodes", "triangles")}
        for _ in range(100_000):
            alive = np.flatnonzero(self.where != DONE)
            if len(alive) == 0:
                return
            whole = rng.random(total) < there
            waited = self.where[alive][self.where[alive] >= 0]
            if len(waited):
                whole[rng.choice(waited)] = True  # what the scheduler does: somebody gets on
            nodes = whole | (rng.random(total) < nodes_there)
            treelets = Treelets()
            treelets.of_node, treelets.root = self.made.treelets.of_node, self.made.treelets.root
            treelets.nodes = wp.array(
                np.where(nodes, tables["nodes"], 0).astype(np.uint64), dtype=wp.uint64, device=self.device
            )
            treelets.triangles = wp.array(
                np.where(whole, tables["triangles"], 0).astype(np.uint64), dtype=wp.uint64, device=self.device
            )
            before = self.where[alive].copy()
            self.run(VisitTask.GO_ON, rng.permutation(alive), treelets)
            after = self.where[alive]
            assert (after != NEW).all() and not whole[after[after >= 0]].any()
            absent = (before >= 0) & ~nodes[np.maximum(before, 0)]
            assert np.array_equal(after[absent], before[absent])
        raise AssertionError("rays never end")


def start(
    name: str, rule: str, device: str, any_first: int | None = None, shared_t: bool = True, **more
) -> tuple[Journey, dict[str, np.ndarray], np.ndarray]:
    """Rays of a case, a third of which ask for any hit by default, and the hits that they should find."""
    made = case(name, device)
    any_first = 2 * len(made.origin) // 3 if any_first is None else any_first
    t_max = t_max_of(len(made.origin), 4)
    rays = make_rays(made, device, t_max, shared_t)
    return (
        Journey(cut(name, rule, device), rays, any_first, **more),
        expected_hits(made, device, t_max, any_first),
        t_max,
    )
