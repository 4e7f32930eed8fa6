"""Hits side by side."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from benchmarking.judge import UNIT_ROUNDOFF

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import Rays

ROUNDINGS_EQUAL = wp.constant(
    8.0 * UNIT_ROUNDOFF
)  # distances that differ by no more, relative to the coordinates, are the same to two tracers


def hits_beside(rays: Rays) -> Rays:
    """The same rays with room for other hits."""
    beside, count, device = Rays(), rays.t_max.shape[0], rays.t_max.device
    beside.origin, beside.direction, beside.t_max, beside.visibility = (
        rays.origin,
        rays.direction,
        rays.t_max,
        rays.visibility,
    )
    beside.hit_t = wp.zeros(count, dtype=float, device=device)
    beside.hit_instance, beside.hit_primitive = (wp.full(count, -7, dtype=int, device=device) for _ in range(2))
    beside.hit_uv = wp.zeros(count, dtype=wp.vec2, device=device)
    return beside


@wp.kernel(**KERNEL_OPTIONS)
def unequal_kernel(mine: Rays, other: Rays, found: wp.array(dtype=wp.uint8)):
    """Which closest hits are not the same, to the bit."""
    i = wp.tid()
    unequal = (mine.hit_instance[i] >= 0) != (other.hit_instance[i] >= 0)
    if mine.hit_instance[i] >= 0:
        unequal = (
            mine.hit_instance[i] != other.hit_instance[i]
            or mine.hit_primitive[i] != other.hit_primitive[i]
            or wp.cast(mine.hit_t[i], wp.int32) != wp.cast(other.hit_t[i], wp.int32)
            or wp.cast(mine.hit_uv[i][0], wp.int32) != wp.cast(other.hit_uv[i][0], wp.int32)
            or wp.cast(mine.hit_uv[i][1], wp.int32) != wp.cast(other.hit_uv[i][1], wp.int32)
        )
    found[i] = wp.uint8(0)
    if unequal:
        found[i] = wp.uint8(1)


@wp.kernel(**KERNEL_OPTIONS)
def unequal_any_kernel(mine: Rays, any_hit: Rays, found: wp.array(dtype=wp.uint8)):
    """Where any hit and closest hit do not agree."""
    i = wp.tid()
    found[i] = wp.uint8(0)
    if (mine.hit_instance[i] >= 0) != (any_hit.hit_instance[i] >= 0):
        found[i] = wp.uint8(1)


@wp.kernel(**KERNEL_OPTIONS)
def limits_kernel(hits: Rays, later: int, t_max: wp.array(dtype=float)):
    """Rays that end at their hits, or (`later`) at the next number after."""
    i = wp.tid()
    t_max[i] = hits.t_max[i]
    if hits.hit_instance[i] >= 0:
        t_max[i] = wp.cast(wp.cast(hits.hit_t[i], wp.int32) + later, wp.float32)


@wp.kernel(**KERNEL_OPTIONS)
def disagree_kernel(mine: Rays, other: Rays, centre: wp.vec3, extent: float, found: wp.array(dtype=wp.uint8)):
    """Where two tracers differ by more than roundings."""
    i = wp.tid()
    found[i] = wp.uint8(0)
    mine_hit, other_hit = mine.hit_instance[i] >= 0, other.hit_instance[i] >= 0
    if mine_hit != other_hit:
        found[i] = wp.uint8(1)
    elif mine_hit:
        size = wp.max(wp.abs(mine.direction[i]))
        scale = wp.max(wp.abs(mine.origin[i] - centre)) + extent + other.hit_t[i] * size
        if not (wp.abs(mine.hit_t[i] - other.hit_t[i]) * size <= ROUNDINGS_EQUAL * scale):
            found[i] = wp.uint8(1)


def where_found(kernel: wp.Kernel, inputs: list, count: int, device: wp.Device) -> np.ndarray:
    """Slots that `kernel`, whose last parameter are flags, marks; int64."""
    found = wp.zeros(count, dtype=wp.uint8, device=device)
    wp.launch(kernel, count, [*inputs, found], device=device)
    return np.flatnonzero(found.numpy())


def ray_record(rays: Rays, slot: int) -> dict[str, Any]:
    """One ray and its hit, to the bit."""
    values = {
        name: getattr(rays, name)[slot : slot + 1].numpy()[0]
        for name in ("origin", "direction", "t_max", "visibility", "hit_t", "hit_instance", "hit_primitive")
    }
    return {
        name: [float(x).hex() for x in np.ravel(value)] if value.dtype == np.float32 else int(value)
        for name, value in values.items()
    }
