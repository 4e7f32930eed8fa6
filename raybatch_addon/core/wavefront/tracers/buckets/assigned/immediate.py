"""Rays go on through treelets that were served of late, without waiting."""

from __future__ import annotations

import numpy as np
import warp as wp

from .....bvh.tree import Treelets
from .....device.kernel import KERNEL_OPTIONS
from ..policy import Step
from .steps import AssignedSteps


@wp.kernel(**KERNEL_OPTIONS)
def show_kernel(
    address: wp.array(dtype=wp.uint64), is_there: wp.array(dtype=wp.uint8), shown: wp.array(dtype=wp.uint64)
):
    """Addresses of blocks that are there; 0 for the others."""
    treelet = wp.tid()
    shown[treelet] = wp.where(is_there[treelet] != wp.uint8(0), address[treelet], wp.uint64(0))


class RecentTreelets:
    """The treelets whose buckets were served last, as many as a cache holds: the others seem absent. One that rays pass
    at once is not served, and leaves as any other.
    """

    def __init__(self, treelets: Treelets, treelet_bytes: np.ndarray, cache_bytes: int):
        """Of `treelets`, which take `treelet_bytes` each, int64. `cache_bytes`: what those that are there may take, but
        for those that are visited.
        """
        self._all, self._bytes, self._cache_bytes = treelets, treelet_bytes, cache_bytes
        self._visited = np.zeros(len(treelet_bytes), np.int64)  # the step; 0: not there
        self._step = 0
        self._is_there = wp.zeros(len(treelet_bytes), dtype=wp.uint8, device=treelets.nodes.device)
        self.view = Treelets()
        for name in self._all._cls.vars:
            setattr(self.view, name, getattr(self._all, name))
        self.view.nodes = wp.zeros_like(self._all.nodes)
        self.view.triangles = wp.zeros_like(self._all.triangles)

    def visit(self, treelets: np.ndarray) -> np.ndarray:
        """`treelets` are there from now on, and of the others those served last that have room; which are there."""
        self._step += 1
        self._visited[treelets] = self._step
        recent = np.argsort(-self._visited, kind="stable")[: np.count_nonzero(self._visited)]
        has_room = np.cumsum(self._bytes[recent]) <= self._cache_bytes
        there = np.union1d(treelets, recent[has_room])
        self._visited[np.setdiff1d(recent, there)] = 0
        flags = np.zeros(len(self._visited), np.uint8)
        flags[there] = 1
        self._is_there.assign(flags)
        for name in ("nodes", "triangles"):
            inputs = [getattr(self._all, name), self._is_there, getattr(self.view, name)]
            wp.launch(show_kernel, len(flags), inputs, device=self._is_there.device)
        return there


class ImmediateSteps(AssignedSteps):
    """Rays of the buckets that are chosen enter their treelets and go on at once through all that are in a cache, until
    they come to another one (Keely 2014, "Reduced precision hardware for ray tracing", where a ray goes on as long as
    it finds its treelet resident). They wait in entry queues alone. A `Steps`.
    """

    def __init__(self, recent: RecentTreelets, *arguments, **options):
        """The rest is that of `AssignedSteps`."""
        super().__init__(*arguments, **options)
        self._recent = recent

    def serve(self, step: Step, choice: list[int]) -> None:
        """See `Steps.serve`."""
        for _, queues, amount in self._served:
            treelets = np.array(queues) // 2
            self._recent.visit(treelets[treelets < self._numbers.bucket_count])
            self._server.go_on(queues, amount, self._recent.view)
