"""Scenes whose geometry need not fit in the device's memory: built chunk by chunk, and kept in pages."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from .node import Layout
from .page_store import Page, PageStore
from .tree import Tree


@dataclass
class PagedScene:
    """The trees of a scene: what stays on the device, and pages of the rest.

    Every mesh is cut into chunks of nearby triangles, each a mesh tree by itself, and each instance has an entry for every chunk of its
    mesh; so there always is a top level (`SceneFeatures.instancing`).
    """

    layout: Layout
    tree: Tree  # on the device: top level, top nodes and roots of treelets, the few triangles right at them
    of_node: wp.array  # as `Treelets`, on the device
    root: wp.array  # likewise
    treelet_count: int
    levels: int  # resident levels on the longest way to a treelet's root: those of the top level and of one mesh's top
    pages: list[Page] = field(repr=False)
    treelet_page: np.ndarray  # int32, shape [treelet_count]
    treelet_node_byte: np.ndarray  # where a treelet's nodes begin in its page on the device, int64, shape [treelet_count]
    treelet_triangle_byte: np.ndarray  # likewise its triangles
    nodes_resident: bool  # pages hold triangles alone; `treelet_node_byte` is then a place in `resident_nodes`
    resident_nodes: wp.array  # uint8, on the device: the nodes of all treelets, or empty
    store: PageStore
    box: np.ndarray  # two corners that hold all surfaces [m], float64, shape [2, 3]
    resident_bytes: int  # of `tree`, `of_node`, `root` and `resident_nodes`
    encoded: bool = False  # pages are expanded on the device (`page_encode.py`)
    statistics: dict[str, Any] = field(default_factory=dict)

    @property
    def page_bytes_max(self) -> int:
        """Bytes of the largest page on the device."""
        return max((page.device_bytes for page in self.pages), default=0)
