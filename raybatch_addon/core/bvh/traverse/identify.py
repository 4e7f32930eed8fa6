"""Which triangle of the scene a hit is of, for kernels in Python; native ones have `traverse/identify.h`."""

from __future__ import annotations

import warp as wp

from ..tree import Tree


@wp.func
def merged_name(
    first: wp.array(dtype=int),
    instance: wp.array(dtype=int),
    triangle_first: wp.array(dtype=int),
    entry: int,
    face: int,
) -> wp.vec2i:
    """Instance and primitive of triangle `face` of an entry that holds baked instances, by the `merged_` arrays of a
    tree.
    """
    low = first[entry]
    high = first[entry + 1] - 1
    while low < high:
        middle = (low + high + 1) / 2
        if triangle_first[middle] <= face:
            low = middle
        else:
            high = middle - 1
    return wp.vec2i(instance[low], face - triangle_first[low])


@wp.func
def name_of(tree: Tree, entry: int, face: int) -> wp.vec2i:
    """Instance and primitive of triangle `face` of an entry."""
    instance = tree.entry_instance[entry]
    if instance >= 0:
        return wp.vec2i(instance, face)
    return merged_name(tree.merged_first, tree.merged_instance, tree.merged_triangle_first, entry, face)
