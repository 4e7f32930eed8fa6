"""Tangents of UV maps at the corners of triangles, after Mikkelsen's tangent space.

Mikkelsen, "Simulation of Wrinkled Surfaces Revisited" (2008). Corners that share position, normal and UV are one.
Triangles of the same orientation that meet there and are joined by edges form a group; its tangent is the mean of the
triangles' tangents, weighted by their angles at the corner.
"""

from __future__ import annotations

import numpy as np

_MIX = np.uint64(0x9E3779B97F4A7C15)  # odd, with bits in no order


def corner_tangents(positions: np.ndarray, normals: np.ndarray, uvs: np.ndarray) -> np.ndarray:
    """Unit tangents and signs of bitangents, float32, shape [n, 3, 4].

    The triangles have corners `positions`, shape [n, 3, 3], `normals` and `uvs`, shape [n, 3, 2].
    """
    count = len(positions)
    corner = _welded(positions, normals, uvs)
    p, uv, n = positions.astype(np.float64), uvs.astype(np.float64), _unit(normals.astype(np.float64))
    edge_1, edge_2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    t21, t31 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = t21[:, 0] * t31[:, 1] - t21[:, 1] * t31[:, 0]
    keeps = area > 0
    along = edge_1 * t31[:, 1:] - edge_2 * t21[:, 1:]
    along = _unit(along) * np.where(keeps, 1.0, -1.0)[:, None]
    usable = (np.abs(area) > np.finfo(np.float32).tiny) & (np.einsum("ij,ij->i", along, along) > 0.5)
    group = _groups(corner, keeps, usable)

    parts = np.empty((3, count, 3))  # of the tangents of groups
    flat_group = group.reshape(-1)
    edges = p[:, [1, 2, 0]] - p  # from each corner to the next
    for k in range(3):
        normal = n[:, k]
        tangent = _unit(_projected(along, normal))
        a = _unit(_projected(-edges[:, (k + 2) % 3], normal))
        b = _unit(_projected(edges[:, k], normal))
        angle = np.arccos(np.clip(np.einsum("ij,ij->i", a, b), -1, 1))
        parts[k] = tangent * (angle * usable)[:, None]
    of_part = group.T.ravel()
    total = np.stack([np.bincount(of_part, parts[..., axis].ravel(), 3 * count) for axis in range(3)], 1)
    tangents = _unit(total[flat_group]).reshape(count, 3, 3)
    # triangles without area in the map take the tangent of others at the same corner
    signs = np.where(keeps, 1.0, -1.0)
    lost = ~usable
    if lost.any():
        known: dict[int, tuple[int, int]] = {}
        for t, k in zip(*np.nonzero(np.isin(corner, corner[lost]) & usable[:, None])):
            known.setdefault(int(corner[t, k]), (t, k))
        for t in np.flatnonzero(lost).tolist():
            for k in range(3):
                source = known.get(int(corner[t, k]))
                tangents[t, k] = (1.0, 0.0, 0.0) if source is None else tangents[source]
    return np.concatenate([tangents, np.broadcast_to(signs[:, None, None], (count, 3, 1))], 2).astype(np.float32)


def _welded(*of_corners: np.ndarray) -> np.ndarray:
    """Numbers of corners, equal where all values are, shape [n, 3]."""
    # with 0 added, which makes -0 the same as 0
    together = np.concatenate([np.asarray(each, np.float32) + np.float32(0) for each in of_corners], 2)
    bits = np.ascontiguousarray(together.reshape(-1, together.shape[2])).view(np.uint32)
    # Equal rows have equal keys, and numbers sort much faster than rows do
    key = np.zeros(len(bits), np.uint64)
    for column in bits.T:
        key = (key ^ column) * _MIX
        key ^= key >> np.uint64(29)
    order = np.argsort(key)
    rows, starts = np.take(bits, order, 0), np.ones(len(bits), bool)
    starts[1:] = (rows[1:] != rows[:-1]).any(1)
    changes = np.ones(len(bits), bool)
    changes[1:] = key[order[1:]] != key[order[:-1]]
    if (starts != changes).any():  # rows that differ have one key
        return np.unique(bits, axis=0, return_inverse=True)[1].reshape(-1, 3)
    number = np.empty(len(bits), np.int64)
    number[order] = np.cumsum(starts) - 1
    return number.reshape(-1, 3)


def _groups(corner: np.ndarray, keeps: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """A number below 3 n for each corner of each triangle: equal for those that share a tangent."""
    count = len(corner)
    label = np.arange(3 * count).reshape(count, 3)
    # the ends of each edge, in one order, with their indices among all corners
    starts, ends = np.array([0, 1, 2]), np.array([1, 2, 0])
    a, b = corner[:, starts].ravel(), corner[:, ends].ravel()
    swap = a > b
    low, high = np.where(swap, b, a), np.where(swap, a, b)
    at_a, at_b = label[:, starts].ravel(), label[:, ends].ravel()
    at_low, at_high = np.where(swap, at_b, at_a), np.where(swap, at_a, at_b)
    side = np.repeat(keeps * 2 + usable, 3)
    edge = (low * (3 * count) + high) * 4 + side  # below 2^63 for a billion corners
    order = np.argsort(edge)
    same = (edge[order[1:]] == edge[order[:-1]]) & usable[order[1:] // 3]
    first, second = order[:-1][same], order[1:][same]
    pairs = np.concatenate(
        [np.stack([at_low[first], at_low[second]], 1), np.stack([at_high[first], at_high[second]], 1)]
    )
    found = label.ravel().copy()
    while len(pairs):
        least = np.minimum(found[pairs[:, 0]], found[pairs[:, 1]])
        before = found.copy()
        np.minimum.at(found, pairs[:, 0], least)
        np.minimum.at(found, pairs[:, 1], least)
        found = found[found]
        if np.array_equal(before, found):
            break
    return found.reshape(count, 3)


def _projected(v: np.ndarray, normal: np.ndarray) -> np.ndarray:
    return v - normal * np.einsum("ij,ij->i", v, normal)[:, None]


def _unit(v: np.ndarray) -> np.ndarray:
    # by columns: NumPy is slow at sums of three
    length = np.sqrt(v[..., 0] ** 2 + v[..., 1] ** 2 + v[..., 2] ** 2)
    return v / np.where(length > 0, length, 1)[..., None]
