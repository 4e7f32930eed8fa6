"""Orders in which the same rays are traced."""

from __future__ import annotations

import numpy as np
from lib.command import UsageError

from benchmarking.rays import CapturedRays

ORDERS = ("natural", "shuffled", "sorted")
MORTON_BITS = 9  # a coordinate: with the three bits of the octant, 30 bits in all


def parse_orders(text: str) -> list[str]:
    """The orders of a list such as `natural,sorted`; raises `UsageError`."""
    orders = list(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in orders:
        if name not in ORDERS:
            raise UsageError(f"--orders {name!r} is not known: choose of {', '.join(ORDERS)}")
    return orders


def ordered(rays: CapturedRays, order: str) -> CapturedRays:
    """`rays` as the integrator submits them (natural), shuffled with a fixed seed, or sorted by `sort_keys`."""
    if order == "natural":
        return rays
    if order == "shuffled":
        return rays.taken(np.random.default_rng(1).permutation(len(rays)))
    return rays.taken(np.argsort(sort_keys(rays.origin, rays.direction), kind="stable"))


def sort_keys(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The direction's octant, then the Morton code of the origin within the origins' box; uint32, shape [n]."""
    low, high = origin.min(0).astype(np.float64), origin.max(0).astype(np.float64)
    cells = (origin - low) / np.where(high > low, high - low, 1) * (2**MORTON_BITS - 1)
    octant = (direction < 0) @ np.array([1, 2, 4])
    key = octant.astype(np.uint32) << np.uint32(3 * MORTON_BITS)
    for axis in range(3):
        key |= _spread(cells[:, axis].astype(np.uint32)) << np.uint32(axis)
    return key


def _spread(values: np.ndarray) -> np.ndarray:
    """Bits of `values` with two zeros between them, uint32."""
    spread = np.zeros_like(values)
    for bit in range(MORTON_BITS):
        spread |= ((values >> np.uint32(bit)) & np.uint32(1)) << np.uint32(3 * bit)
    return spread
