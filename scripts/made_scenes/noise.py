"""Noise over a plane, the same on every machine: lattice values from a hash of integers."""

from __future__ import annotations

import numpy as np


def value_noise(x: np.ndarray, y: np.ndarray, seed: int) -> np.ndarray:
    """Smooth noise in -1..1 with cells of edge 1; float64, the shape of `x` and `y`."""
    left, low = np.floor(x), np.floor(y)
    u, v = x - left, y - low
    i, j = left.astype(np.int64), low.astype(np.int64)
    u, v = (each * each * each * (each * (each * 6 - 15) + 10) for each in (u, v))
    corners = [_lattice(i + a, j + b, seed) for b in (0, 1) for a in (0, 1)]
    return (corners[0] * (1 - u) + corners[1] * u) * (1 - v) + (corners[2] * (1 - u) + corners[3] * u) * v


def fractal_noise(x: np.ndarray, y: np.ndarray, seed: int, octaves: int) -> np.ndarray:
    """Sums of noise of ever smaller cells, about -1..1."""
    total, weight, scale = np.zeros(np.shape(x)), 0.5, 1.0
    for octave in range(octaves):
        total += weight * value_noise(scale * x, scale * y, seed + octave)
        weight, scale = 0.5 * weight, 2.03 * scale
    return total


def _lattice(i: np.ndarray, j: np.ndarray, seed: int) -> np.ndarray:
    """A value in -1..1 for each point of the lattice."""
    with np.errstate(over="ignore"):
        mixed = i.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + j.astype(np.uint64) * np.uint64(
            0xC2B2AE3D27D4EB4F
        )
        mixed += np.uint64(seed) * np.uint64(0x165667B19E3779F9)
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        mixed ^= mixed >> np.uint64(31)
    return (mixed >> np.uint64(11)).astype(np.float64) * (2.0 / (1 << 53)) - 1
