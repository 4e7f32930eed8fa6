"""Rays that visit the treelets of a tree of BOXES in orders at random."""

from __future__ import annotations

import functools

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.traverse.counts import NO_COUNTS, TraceCounts
from raybatch_addon.core.bvh.traverse.cpu_visit import visit_function
from raybatch_addon.core.bvh.traverse.options import INTERLEAVE, TopLevelTraversal, TraceOptions, VisitOptions
from raybatch_addon.core.bvh.traverse.task import VisitTask
from raybatch_addon.core.bvh.tree import DONE, NEW, TRAIL_LEVELS, TopProgress, Tree, Treelets
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import DeviceRayList, RayList, Rays, fill_list
from raybatch_addon.core.wavefront.tracers.unbatched import boxes_kernel
from tests.core.bvh.traverse.cpu_visit_scenes import case, cut, list_of, make_rays, t_max_of, uploaded

HITS = ("hit_t", "hit_instance", "hit_primitive", "hit_uv")
COUNTED = ("node_steps", "box_tests", "triangle_tests", "treelet_visits", "queued")


@functools.cache
def expected_hits(name: str, any_first: int) -> dict[str, np.ndarray]:
    """By the traversal of the uncut tree."""
    rays, slots = make_rays(name), np.arange(len(case(name).origin))
    for any_hit, part in ((False, slots[slots < any_first]), (True, slots[slots >= any_first])):
        kernel = boxes_kernel(TraceOptions(any_hit=any_hit, instancing=case(name).built.instancing))
        wp.launch(kernel, 1, [case(name).built.tree, rays, list_of(part), 1, NO_COUNTS], device="cpu")
    return {field: getattr(rays, field).numpy() for field in HITS}


@functools.cache
def visit_kernel(
    task: VisitTask, instancing: bool, interleave: int = INTERLEAVE, counters: bool = False, interlocked: bool = False
) -> wp.Kernel:
    """Kernel (tree, treelets, progress, rays, listed, first, end, counts)."""
    together = TopLevelTraversal.INTERLOCKED if interlocked else TopLevelTraversal.NAIVE
    visit = visit_function(
        VisitOptions(task=task, instancing=instancing, interleave=interleave, counters=counters, top_level=together)
    )

    @wp.kernel(**KERNEL_OPTIONS)
    def kernel(
        tree: Tree,
        treelets: Treelets,
        progress: TopProgress,
        rays: Rays,
        listed: DeviceRayList,
        first: int,
        end: int,
        counts: TraceCounts,
    ):
        visit(tree, treelets, progress, rays, listed, first, end, counts)

    return kernel


class Journey:
    """Rays on their way through a cut tree: where each waits, on the host. A third of them ask for any hit by
    default.
    """

    def __init__(
        self,
        name: str,
        rule: str,
        any_first: int | None = None,
        shared_t=True,
        interleave=INTERLEAVE,
        interlocked=False,
        counted=False,
    ):
        self.name, self.made, count = name, cut(name, rule), len(case(name).origin)
        self.any_first = 2 * count // 3 if any_first is None else any_first
        self.rays = make_rays(name, shared_t, self.any_first)
        self.interleave, self.interlocked = interleave, interlocked
        self.progress = TopProgress()
        self.progress.trail = wp.full(
            (-(-self.made.levels // TRAIL_LEVELS), count), 0xFFFFFFFF, dtype=wp.uint32, device="cpu"
        )
        self.progress.entry = wp.full(count if self.made.instancing else 0, -5, dtype=int, device="cpu")
        self.progress.visits = wp.zeros(1, dtype=wp.int64, device="cpu")
        self.where = np.full(count, NEW, np.int32)
        self.counts = None
        if counted:
            self.counts = TraceCounts()
            for field in COUNTED:
                setattr(self.counts, field, wp.full(count, -9, dtype=int, device="cpu"))

    def run(self, task: VisitTask, slots: np.ndarray, treelets: Treelets | None = None) -> None:
        """`task` for the rays in `slots`, between others of the batch that are not the launch's."""
        where, chosen = (uploaded(np.concatenate([[NEW], x, [NEW]])) for x in (self.where[slots], slots))
        listed = DeviceRayList()
        fill_list(listed, RayList(chosen, None, len(slots), where), self.any_first)
        kernel = visit_kernel(task, self.made.instancing, self.interleave, self.counts is not None, self.interlocked)
        treelets, counts = treelets or self.made.treelets, self.counts or NO_COUNTS
        inputs = [self.made.tree, treelets, self.progress, self.rays, listed, 1, len(slots) + 1, counts]
        wp.launch(kernel, 1, inputs, device="cpu")
        assert where.numpy()[0] == where.numpy()[-1] == NEW
        self.where[slots] = where.numpy()[1:-1]

    def visits(self) -> int:
        return int(self.progress.visits.numpy()[0])

    def treelets(self, nodes: np.ndarray, triangles: np.ndarray) -> Treelets:
        """The tables with those treelets there."""
        tables, made = Treelets(), self.made.treelets
        tables.of_node, tables.root = made.of_node, made.root
        tables.nodes = wp.array(np.where(nodes, made.nodes.numpy(), 0).astype(np.uint64), dtype=wp.uint64, device="cpu")
        tables.triangles = wp.array(
            np.where(triangles, made.triangles.numpy(), 0).astype(np.uint64), dtype=wp.uint64, device="cpu"
        )
        return tables

    def alternate(self, rng: np.random.Generator) -> int:
        """Top level and treelets in turn, rays in batches at random, until all are done; how many visits there should
        have been.
        """
        inside, visits = np.zeros(len(self.where), bool), 0  # the ray was in the treelet that it waits at
        for _ in range(10_000):
            alive = np.flatnonzero(self.where != DONE)
            if len(alive) == 0:
                return visits
            chosen = rng.permutation(alive)[: rng.integers(1, 2 * len(alive) + 2)]
            enters = (self.where[chosen] >= 0) & ~inside[chosen]
            for task, slots in ((VisitTask.TREELET, chosen[enters]), (VisitTask.TOP, chosen[~enters])):
                before = self.where[slots]
                self.run(task, slots)
                after = self.where[slots]
                inside[slots] = task is VisitTask.TREELET
                if task is VisitTask.TREELET:
                    visits += len(slots)
                    assert ((after == before) | ((after == DONE) & (slots >= self.any_first))).all()
                else:
                    assert (after != NEW).all() and (self.made.instancing or (after != before).all())
        raise AssertionError("rays never end")

    def go_on(self, rng: np.random.Generator, there: float, nodes_there: float) -> None:
        """`GO_ON` with other treelets there each time, some of them without triangles, until all rays are done."""
        total = self.made.treelet_count
        for _ in range(10_000):
            alive = np.flatnonzero(self.where != DONE)
            if len(alive) == 0:
                return
            whole = rng.random(total) < there
            waiting = self.where[alive][self.where[alive] >= 0]
            if len(waiting):
                whole[rng.choice(waiting)] = True
            nodes = whole | (rng.random(total) < nodes_there)
            before = self.where[alive]
            self.run(VisitTask.GO_ON, rng.permutation(alive), self.treelets(nodes, whole))
            after = self.where[alive]
            assert (after != NEW).all() and not whole[after[after >= 0]].any()
            absent = (before >= 0) & ~nodes[np.maximum(before, 0)]
            assert np.array_equal(after[absent], before[absent])
        raise AssertionError("rays never end")

    def check(self) -> None:
        """All hits are those of the uncut tree, to the bit; of any-hit rays whether there is one, and their `t_max` is
        as it was.
        """
        assert (self.where == DONE).all()
        first, expected = self.any_first, expected_hits(self.name, self.any_first)
        for field in HITS:
            found = getattr(self.rays, field).numpy()[:first]
            assert np.array_equal(found.view(np.uint32), expected[field][:first].view(np.uint32)), field
        assert np.array_equal(self.rays.hit_instance.numpy()[first:], expected["hit_instance"][first:])
        assert np.array_equal(
            self.rays.t_max.numpy()[first:].view(np.uint32), t_max_of(self.name)[first:].view(np.uint32)
        )
