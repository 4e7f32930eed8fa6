"""A scene whose pages lie in a file, and whether arrays lie in one."""

import mmap

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.bvh.pages.build import build_paged_scene
from raybatch_addon.core.bvh.pages.paged_scene import PagedScene
from raybatch_addon.core.scene.flatten import flatten
from tests.support import paged_scenes

SCENE = paged_scenes.everything()
FLAT = flatten(SCENE)
BUDGET = 400_000  # bytes


def built(store, folder=None, layout=Layout.BOXES, budget=BUDGET, **more) -> PagedScene:
    """The pages of `FLAT` on the CPU."""
    return build_paged_scene(
        FLAT, SCENE.instances.visibility, layout, wp.get_device("cpu"), budget, store, folder, **more
    )


def is_mapped(array: np.ndarray) -> bool:
    """Whether the memory of `array` is that of a file."""
    part = array
    while isinstance(part, np.ndarray):
        part = part.base
    return isinstance(part, mmap.mmap)
