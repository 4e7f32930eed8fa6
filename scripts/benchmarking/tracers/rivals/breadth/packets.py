"""Kernels that sort rays by a hash, run by run, and cut them into packets."""

from __future__ import annotations

import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.rays import Rays


@wp.struct
class HashRule:
    """How rays are hashed."""

    low: wp.vec3  # of the scene's box [m]
    scale: wp.vec3  # 1 / extent, and 0 along an axis without extent [1/m]
    origin_bits: int  # of a coordinate
    direction_bits: int  # of a coordinate on the unfolded octahedron


@wp.func
def cell_of(x: float, bits: int) -> int:
    """Which of 2^bits cells of 0 to 1."""
    cells = float(int(1) << bits)
    return int(wp.clamp(x * cells, 0.0, cells - 1.0))


@wp.func
def ray_hash(origin: wp.vec3, d: wp.vec3, rule: HashRule) -> wp.uint32:
    """The direction's cell above the origin's."""
    size = wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2])
    u = d[0] / size
    v = d[1] / size
    if d[2] < 0.0:
        folded = (1.0 - wp.abs(v)) * wp.where(u < 0.0, -1.0, 1.0)
        v = (1.0 - wp.abs(u)) * wp.where(v < 0.0, -1.0, 1.0)
        u = folded
    a = cell_of(0.5 * u + 0.5, rule.direction_bits)
    b = cell_of(0.5 * v + 0.5, rule.direction_bits)
    p = wp.cw_mul(origin - rule.low, rule.scale)
    x = cell_of(p[0], rule.origin_bits)
    y = cell_of(p[1], rule.origin_bits)
    z = cell_of(p[2], rule.origin_bits)
    key = int(0)
    for bit in range(rule.direction_bits):
        key = key | (((a >> bit) & 1) | (((b >> bit) & 1) << 1)) << (3 * rule.origin_bits + 2 * bit)
    for bit in range(rule.origin_bits):
        key = key | (((x >> bit) & 1) | (((y >> bit) & 1) << 1) | (((z >> bit) & 1) << 2)) << (3 * bit)
    return wp.uint32(key)


@wp.kernel(**KERNEL_OPTIONS)
def hash_kernel(rays: Rays, rule: HashRule, slots: wp.array(dtype=int), keys: wp.array(dtype=wp.uint32)):
    """The hash of each ray of a list."""
    i = wp.tid()
    keys[i] = ray_hash(rays.origin[slots[i]], rays.direction[slots[i]], rule)


@wp.kernel(**KERNEL_OPTIONS)
def heads_kernel(keys: wp.array(dtype=wp.uint32), heads: wp.array(dtype=int)):
    """1 where a run of equal keys begins, else 0."""
    i = wp.tid()
    if i == 0:
        heads[i] = 1
    else:
        heads[i] = wp.where(keys[i] != keys[i - 1], 1, 0)


@wp.kernel(**KERNEL_OPTIONS)
def cuts_kernel(number: wp.array(dtype=int), starts: wp.array(dtype=int), size: int, heads: wp.array(dtype=int)):
    """1 where a packet begins: at the start of a run, and every `size` rays within it. `number` counts runs from 1."""
    i = wp.tid()
    heads[i] = wp.where((i - starts[number[i] - 1]) % size == 0, 1, 0)


@wp.kernel(**KERNEL_OPTIONS)
def starts_kernel(number: wp.array(dtype=int), starts: wp.array(dtype=int)):
    """Where each run or packet begins, and behind the last of them where it ends."""
    i = wp.tid()
    here = number[i]
    before = int(0)
    if i > 0:
        before = number[i - 1]
    if here != before:
        starts[here - 1] = i
    if i == number.shape[0] - 1:
        starts[here] = i + 1


@wp.kernel(**KERNEL_OPTIONS)
def runs_kernel(
    keys: wp.array(dtype=wp.uint32),
    starts: wp.array(dtype=int),
    run_keys: wp.array(dtype=wp.uint32),
    runs: wp.array(dtype=int),
):
    """What is sorted: the key of each run, and its number."""
    i = wp.tid()
    run_keys[i] = keys[starts[i]]
    runs[i] = i


@wp.kernel(**KERNEL_OPTIONS)
def lengths_kernel(runs: wp.array(dtype=int), starts: wp.array(dtype=int), lengths: wp.array(dtype=int)):
    """Rays of each run, in the order of keys."""
    i = wp.tid()
    lengths[i] = starts[runs[i] + 1] - starts[runs[i]]


@wp.kernel(**KERNEL_OPTIONS)
def places_kernel(runs: wp.array(dtype=int), offsets: wp.array(dtype=int), places: wp.array(dtype=int)):
    """Where the rays of each run go, by run."""
    i = wp.tid()
    places[runs[i]] = offsets[i]


@wp.struct
class Sorted:
    """Rays in the order of keys."""

    slots: wp.array(dtype=int)
    keys: wp.array(dtype=wp.uint32)


@wp.kernel(**KERNEL_OPTIONS)
def spread_kernel(
    slots: wp.array(dtype=int),
    keys: wp.array(dtype=wp.uint32),
    number: wp.array(dtype=int),
    starts: wp.array(dtype=int),
    places: wp.array(dtype=int),
    result: Sorted,
):
    """The rays of each run to their place."""
    i = wp.tid()
    run = number[i] - 1
    place = places[run] + i - starts[run]
    result.slots[place] = slots[i]
    result.keys[place] = keys[i]
