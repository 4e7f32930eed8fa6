"""What rays do in a step where geometry comes in pages: they go on through all that is there, or, where treelets of a
page are a tier of their own, visit the one that they wait at, in the order of treelets, and come to the next.
"""

from __future__ import annotations

import warp as wp

from ....bvh.node import Layout
from ....bvh.traverse.counts import TraceCounts
from ....bvh.traverse.options import VisitOptions
from ....bvh.traverse.task import VisitTask
from ....bvh.tree import TopProgress, Tree, Treelets
from ....device.kernel import KERNEL_OPTIONS
from ....rays import RayList, Rays
from ....settings.settings import RenderSettings
from ...plan.launch import Launch
from ...plan.plan import has_tiers
from ..visit import VisitStage, visit_stage

_NOWHERE = wp.constant(2**31 - 1)  # behind all treelets
SORT_BYTES = 16
"""Of each ray of a batch that is put in order: a key, a slot, and room for both [bytes]."""


@wp.kernel(**KERNEL_OPTIONS)
def treelet_key_kernel(
    slots: wp.array(dtype=int),
    locations: wp.array(dtype=int),
    count: wp.array(dtype=int),
    keys: wp.array(dtype=int),
    values: wp.array(dtype=int),
):
    """By ray of the batch: what it is sorted by, the treelet that it waits at, and its slot."""
    i = wp.tid()
    key = int(_NOWHERE)
    if i < count[0]:
        key = locations[i]
        values[i] = slots[i]
    keys[i] = key


@wp.kernel(**KERNEL_OPTIONS)
def sorted_batch_kernel(
    keys: wp.array(dtype=int),
    values: wp.array(dtype=int),
    count: wp.array(dtype=int),
    slots: wp.array(dtype=int),
    locations: wp.array(dtype=int),
):
    """By sorted ray: back to the batch."""
    i = wp.tid()
    if i < count[0]:
        slots[i] = values[i]
        locations[i] = keys[i]


class TreeletStage:
    """Rays at treelets that are there visit these, one treelet after another, and go on through the top level to the
    next; new rays begin there. A `VisitStage`.
    """

    writes_queues = False

    def __init__(self, visit: VisitStage, top: VisitStage):
        """`visit` does the task TREELET, `top` the task TOP."""
        self._visit, self._top = visit, top
        self._keys = self._values = None
        self.kernels = (treelet_key_kernel, sorted_batch_kernel, *visit.kernels, *top.kernels)

    def prepare(self, device: wp.Device) -> None:
        """See `VisitStage.prepare`."""
        self._visit.prepare(device)
        self._top.prepare(device)

    def launch(
        self,
        tree: Tree,
        treelets: Treelets,
        rays: Rays,
        progress: TopProgress,
        batch: RayList,
        any_first: int,
        counts: TraceCounts | None,
    ) -> None:
        """See `VisitStage.launch`; `batch` is put in order."""
        self._sort(batch)
        for stage in (self._visit, self._top):
            stage.launch(tree, treelets, rays, progress, batch, any_first, counts)

    def _sort(self, batch: RayList) -> None:
        bound, device = batch.bound, batch.slots.device
        if self._keys is None:
            # sorting takes as much again behind them
            self._keys, self._values = (wp.empty(2 * batch.slots.size, dtype=int, device=device) for _ in range(2))
        sorted_by = self._keys, self._values
        wp.launch(treelet_key_kernel, bound, [batch.slots, batch.locations, batch.count, *sorted_by], device=device)
        wp.utils.radix_sort_pairs(*sorted_by, bound)
        wp.launch(sorted_batch_kernel, bound, [*sorted_by, batch.count, batch.slots, batch.locations], device=device)


def page_stage(
    layout: Layout, counters: bool, settings: RenderSettings, curves: bool = False, moving: bool = False
) -> VisitStage:
    """The stage that traces."""

    def doing(task: VisitTask) -> VisitStage:
        options = VisitOptions(task=task, instancing=True, counters=counters, curves=curves, motion=moving)
        return visit_stage(layout, options, Launch.of(settings))

    if has_tiers(settings):
        return TreeletStage(doing(VisitTask.TREELET), doing(VisitTask.TOP))
    return doing(VisitTask.GO_ON)
