"""Stage: rays come back from the tracer. Next: shading, when both rays of a path are back."""

from __future__ import annotations


import warp as wp

from ...kernel import KERNEL_OPTIONS
from ..rays import Paths, Rays, Status

RAY_OUT = int(Status.RAY_OUT)
SHADOW_OUT = int(Status.SHADOW_OUT)
HIT = int(Status.HIT)


@wp.kernel(**KERNEL_OPTIONS)
def settle_kernel(paths: Paths, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
    """Extending rays are back."""
    i = wp.tid()
    if i >= count[0]:
        return
    path = slots[i]
    status = paths.status[path] & ~wp.static(RAY_OUT | HIT)
    if rays.hit_instance[path] >= 0:
        status = status | wp.static(HIT)
    paths.status[path] = status


@wp.kernel(**KERNEL_OPTIONS)
def connect_kernel(paths: Paths, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
    """Shadow rays are back: light that nothing hides is added to the path."""
    i = wp.tid()
    if i >= count[0]:
        return
    slot = slots[i]
    path = slot - paths.status.shape[0]
    if rays.hit_instance[slot] < 0:
        paths.radiance[path] = paths.radiance[path] + paths.shadow_light[path]
    paths.status[path] = paths.status[path] & ~wp.static(SHADOW_OUT)
