"""Which triangle of the scene a hit is of, for kernels in Python; native ones have `traverse/identify.h`."""

from __future__ import annotations

import warp as wp

from ..tree import Tree


@wp.func
def name_of(tree: Tree, entry: int, face: int) -> wp.vec2i:
    """Instance and primitive of triangle `face` of an entry."""
    instance = tree.entry_instance[entry]
    if instance >= 0:
        return wp.vec2i(instance, face)
    low = tree.merged_first[entry]
    high = tree.merged_first[entry + 1] - 1
    while low < high:
        middle = (low + high + 1) / 2
        if tree.merged_triangle_first[middle] <= face:
            low = middle
        else:
            high = middle - 1
    return wp.vec2i(tree.merged_instance[low], face - tree.merged_triangle_first[low])
