"""A scene beyond memory, as a scene's tree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...bvh.pages.paged_scene import PagedScene
from ...bvh.pages.residency import Residency
from ...bvh.tree import Tree


@dataclass
class PagedTree:
    """A scene beyond memory, and what of it is on the device."""

    scene: PagedScene
    residency: Residency

    @property
    def tree(self) -> Tree:
        """What stays on the device."""
        return self.scene.tree

    @property
    def box(self) -> np.ndarray:
        """Two corners that hold all surfaces [m], float64, shape [2, 3]."""
        return self.scene.box

    @property
    def statistics(self) -> dict[str, Any]:
        """What the trees are."""
        return self.scene.statistics
