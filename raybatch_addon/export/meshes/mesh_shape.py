"""Values that Cycles derives from a mesh's shape: pointiness, and a random number for each island."""

from __future__ import annotations

import numpy as np

from ..lookup3 import lookup3

# Squared distance below which vertices count as one [m²]
_SAME = np.finfo(np.float32).eps


def pointiness(positions: np.ndarray, normals: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Pointiness of each vertex, float32.

    It is how far the mean of the vertex's edge directions is turned from the normal, over pi, then blurred by one ring.
    Vertices at one position count as one.
    """
    same = welded(positions)
    count = len(positions)
    normal = np.zeros((count, 3))
    np.add.at(normal, same, normals.astype(np.float64))
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    ends = np.unique(np.sort(same[edges], axis=1), axis=0) if len(edges) else np.zeros((0, 2), int)
    a, b = ends.T
    direction = positions[b].astype(np.float64) - positions[a]
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-30)
    total, degree = np.zeros((count, 3)), np.zeros(count)
    np.add.at(total, a, direction)
    np.add.at(total, b, -direction)
    np.add.at(degree, a, 1)
    np.add.at(degree, b, 1)
    cosine = np.einsum("ij,ij->i", normal, total / np.maximum(degree, 1)[:, None])
    raw = np.where(degree > 0, np.arccos(np.clip(cosine, -1, 1)) / np.pi, 0.0)
    blurred = raw.copy()
    np.add.at(blurred, a, raw[b])
    np.add.at(blurred, b, raw[a])
    return (blurred / (degree + 1))[same].astype(np.float32)


def welded(positions: np.ndarray) -> np.ndarray:
    """Number of the first vertex at each vertex's position, int, shape [n]."""
    same = np.arange(len(positions))
    sums = positions.astype(np.float64).sum(1)
    order = np.argsort(sums, kind="stable")
    reach = 3 * np.sqrt(_SAME)
    ends = np.searchsorted(sums[order], sums[order] + reach, side="right")
    crowded = np.flatnonzero(ends > np.arange(len(order)) + 1)
    taken = np.zeros(len(positions), bool)
    for at in crowded.tolist():
        vertex = order[at]
        if taken[vertex]:
            continue
        others = order[at + 1 : ends[at]]
        near = others[((positions[others] - positions[vertex]) ** 2).sum(1) < _SAME]
        near = near[~taken[near]]
        same[near] = vertex
        taken[near] = True
    return same


def random_per_island(vertex_count: int, edges: np.ndarray) -> np.ndarray:
    """Random number of each vertex, float32 in [0, 1], the same across an island.

    It is drawn from the number of the vertex that stands for all connected ones.
    """
    parents, ranks = list(range(vertex_count)), [0] * vertex_count

    def root_of(x: int) -> int:
        root = x
        while parents[root] != root:
            root = parents[root]
        while parents[x] != root:
            parents[x], x = root, parents[x]
        return root

    # union by rank in the order of the edges, as in Cycles: another order would choose other representatives
    for a, b in edges.tolist():
        x, y = root_of(a), root_of(b)
        if x == y:
            continue
        if ranks[x] < ranks[y]:
            x, y = y, x
        parents[y] = x
        if ranks[x] == ranks[y]:
            ranks[x] += 1
    roots = np.array([root_of(x) for x in range(vertex_count)], np.uint32)
    return (lookup3(roots).astype(np.float32) * np.float32(1 / 0xFFFFFFFF)).astype(np.float32)
