"""A scene in pages: what stays on the device, and where the rest lies."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import warp as wp

from ..node import Layout
from ..tree import Tree
from .encode import expand_page
from .store import HostStore, Page, PageStore


@dataclass(kw_only=True)
class PagedScene:
    """The trees of a scene: what stays on the device, and pages of the rest.

    Every mesh is cut into chunks of nearby triangles, each a mesh tree by itself, and each instance has an entry for
    every chunk of its mesh; so there always is a top level (`SceneFeatures.instancing`).
    """

    layout: Layout
    tree: Tree  # on the device: top level, top nodes and roots of treelets, the few triangles right at them
    of_node: wp.array  # as `Treelets`, on the device
    root: wp.array  # likewise
    deform: wp.array  # likewise
    treelet_count: int
    levels: int  # resident levels on the longest way to a treelet's root: those of the top level and of one mesh's top
    pages: list[Page] = field(repr=False)
    treelet_page: np.ndarray  # int32, shape [treelet_count]
    # where a treelet's nodes begin in its page on the device, int64, shape [treelet_count]
    treelet_node_byte: np.ndarray
    treelet_triangle_byte: np.ndarray  # likewise its triangles
    nodes_resident: bool  # pages hold triangles alone; `treelet_node_byte` is then a byte of `resident_nodes`
    resident_nodes: wp.array  # as `page_rows`, on the device: the nodes of all treelets, or empty
    store: PageStore
    box: np.ndarray  # two corners that hold all surfaces [m], float64, shape [2, 3]
    # of `tree`, `of_node`, `root` and `resident_nodes`, and of pages that the device holds for all that render
    resident_bytes: int
    # where the triangles of each page begin, in the store and on the device, int64, shape [pages]
    page_node_bytes: np.ndarray
    page_units: np.ndarray  # triangles, or groups of them (BOXES), of each page, likewise
    encoded: bool = False  # triangles are packed, and every page must be expanded where it arrives
    plain: HostStore | None = field(
        default=None, repr=False
    )  # pages of an encoded scene as the device has them, for rays to read there
    plain_byte: list[int] = field(default_factory=list, repr=False)  # where each begins
    # addresses of pages that the device holds itself, as it reads them, uint64, shape [pages]; 0: not there. None: none
    home: np.ndarray | None = field(default=None, repr=False)
    statistics: dict[str, Any] = field(default_factory=dict)

    @property
    def page_bytes_max(self) -> int:
        """Bytes of the largest page on the device."""
        return max((page.device_bytes for page in self.pages), default=0)

    def plain_view(self, page: int) -> wp.array | None:
        """Page number `page` in host memory as the device has it; None where there is no such copy."""
        if self.plain is None:
            return None
        return self.plain.view(
            replace(self.pages[page], byte_first=self.plain_byte[page], byte_count=self.pages[page].device_bytes)
        )

    def expand(self, page: int, source: wp.array, target: wp.array) -> None:
        """Bring page number `page` of an encoded scene from `source` to `target`, in the current stream; as
        `expand_page`.
        """
        nodes = int(self.page_node_bytes[page])
        expand_page(source, target, nodes, nodes, int(self.page_units[page]))
