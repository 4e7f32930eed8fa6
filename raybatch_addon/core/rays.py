"""Rays on the device, and lists of them: what the integrator and a tracer hand to each other."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import warp as wp


class RayKind(IntEnum):
    """The question that is asked of a ray."""

    CLOSEST = 0  # the closest hit
    OCCLUSION = 1  # whether anything is hit
    TRANSPARENT_SHADOW = 2  # the closest hit, asked again from there on while surfaces let light through


@wp.struct
class Rays:
    """Rays and their hits, one entry a ray slot; some arrays have entries only for the slots that need them
    (`allocate_rays`).
    """

    origin: wp.array(dtype=wp.vec3)  # [m]
    direction: wp.array(dtype=wp.vec3)  # unit length in world space
    t_max: wp.array(dtype=float)  # only hits nearer than this count [m]
    # `Visibility` bit of the ray: objects without it are passed. No entries: all is seen
    visibility: wp.array(dtype=int)
    time: wp.array(dtype=float)  # of each path, 0 to 1 while the shutter is open; no entries where nothing moves
    hit_t: wp.array(dtype=float)  # distance of the hit, or `t_max` [m]. May be the same memory as `t_max`
    # -1: nothing was hit. Of occlusion rays only this is set, and only its sign counts
    hit_instance: wp.array(dtype=int)
    # triangle of the instance's mesh. Has entries for closest hits alone, like `hit_uv`
    hit_primitive: wp.array(dtype=int)
    hit_uv: wp.array(dtype=wp.vec2)  # barycentric weights of the triangle's second and third corner


@dataclass(frozen=True)
class RayList:
    """Rays on the device, each once; the length is known exactly there and bounded on the host."""

    slots: wp.array  # ray slots, int32, shape [>= bound]
    count: wp.array  # rays in the list, int32, shape [1]
    bound: int  # at least `count[0]`
    # `NEW`, `DONE` or the treelet at which each ray waits, int32, shape [>= bound]; None if rays do not wait
    locations: wp.array | None = None
    coherent: bool = False  # camera rays: neighbours in the list visit the same nodes


NO_RAYS = RayList(None, None, 0)
"""Stands for an empty list."""

NO_ANY_HIT = 2**31 - 1
"""As `any_first`: all rays ask for their closest hit."""


@wp.struct
class DeviceRayList:
    """A `RayList` as kernels see it. Arrays that a kernel does not need have no entries."""

    slots: wp.array(dtype=int)
    locations: wp.array(dtype=int)  # kernels that move rays write where these came to
    pool_index: wp.array(dtype=int)  # entry of the queues' pool in which each ray lies; -1: in none
    count: wp.array(dtype=int)  # shape [1]
    capacity: int  # of a list that a kernel makes
    any_first: int  # rays in slots from here on ask for any hit, the others for the closest hit


def fill_list(target: DeviceRayList, rays: RayList, any_first: int = NO_ANY_HIT) -> None:
    """Make `target`, which is kept from launch to launch, hold `rays`.

    Setting a field takes a host microseconds, so fields are left that hold their value already.
    """
    if target.slots is not rays.slots:
        target.slots = rays.slots
    if target.count is not rays.count:
        target.count = rays.count
    if target.any_first != any_first:
        target.any_first = any_first
    if rays.locations is not None and target.locations is not rays.locations:
        target.locations = rays.locations
