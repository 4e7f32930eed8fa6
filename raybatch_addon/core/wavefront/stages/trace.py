"""Stage: rays visit the whole tree at once. Next: `connect` for shadow rays, shading for the others."""

from __future__ import annotations

import functools

import warp as wp

from ...bvh.reference import ReferenceTree, make_reference
from ...kernel import KERNEL_OPTIONS
from ..rays import RayKind, Rays


@functools.cache
def trace_kernel(kind: RayKind, instancing: bool) -> wp.Kernel:
    """Kernel (tree, rays, slots, count): trace the rays of the first `count[0]` of `slots`."""
    queries = make_reference(instancing)
    closest = queries.closest
    occluded = queries.occluded

    if kind == RayKind.CLOSEST:

        @wp.kernel(**KERNEL_OPTIONS)
        def trace_closest(tree: ReferenceTree, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
            i = wp.tid()
            if i >= count[0]:
                return
            slot = slots[i]
            hit = closest(tree, rays.origin[slot], rays.direction[slot], rays.t_max[slot], rays.visibility[slot])
            rays.hit_t[slot] = hit.t
            rays.hit_instance[slot] = hit.instance
            rays.hit_primitive[slot] = hit.primitive
            rays.hit_uv[slot] = hit.uv

        return trace_closest

    @wp.kernel(**KERNEL_OPTIONS)
    def trace_occlusion(tree: ReferenceTree, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
        i = wp.tid()
        if i >= count[0]:
            return
        slot = slots[i]
        rays.hit_instance[slot] = -1
        if occluded(tree, rays.origin[slot], rays.direction[slot], rays.t_max[slot], rays.visibility[slot]):
            rays.hit_instance[slot] = 0

    return trace_occlusion
