"""The largest flat faces of a mesh, and its vertices once these faces are moved along their normals. NumPy alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..float32 import UNIT_ROUNDOFF
from .vertices import triangle_crosses, units

PLANES_MOST = 64  # of the largest area
# Roundings of the largest coordinate within which heights of one plane are, and by how much its normals differ
_HEIGHTS, _NORMALS = 64.0, 1e-4
_MIXED = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0x27D4EB2F165667C5], np.uint64)


@dataclass(frozen=True)
class FlatFaces:
    """Planes of a mesh in object space, and which triangles lie in them."""

    plane: np.ndarray  # of each triangle of the mesh; -1: of none that is listed. int32, shape [n]
    normals: np.ndarray  # unit, float64, shape [planes, 3]
    longest: np.ndarray  # the longest edge there [m], float64, shape [planes]


def flat_faces(positions: np.ndarray, triangles: np.ndarray) -> FlatFaces:
    """The planes of largest area. Two that lie on each other from opposite sides are left out, as where parts of a mesh
    stand side by side: these are one volume as long as their faces coincide.
    """
    crosses = triangle_crosses(positions, triangles)
    area, normals = np.linalg.norm(crosses, axis=1), units(crosses)
    corners = positions[triangles].astype(np.float64)
    height = np.einsum("ij,ij->i", normals, corners[:, 0])
    grain = _HEIGHTS * UNIT_ROUNDOFF * float(np.abs(positions).max(initial=0.0)) or 1.0
    cells = np.round(np.column_stack([normals / _NORMALS, height / grain])).astype(np.int64)
    _, first, kind = np.unique(cells.astype(np.uint64) @ _MIXED, return_index=True, return_inverse=True)
    kind = kind.reshape(-1)
    areas = np.bincount(kind, area, len(first))
    largest = np.argsort(-areas, kind="stable")[:PLANES_MOST]
    largest = largest[areas[largest] > 0]
    number = np.full(len(first), -1, np.int32)
    number[largest] = np.arange(len(largest))
    at = first[largest]
    found = FlatFaces(number[kind], normals[at], np.zeros(len(at)))
    return _summed(found, corners, area, height[at], grain)


def _summed(faces: FlatFaces, corners: np.ndarray, area: np.ndarray, height: np.ndarray, grain: float) -> FlatFaces:
    """`faces` without those that lie on each other from opposite sides; those that rounding parted are one."""

    def close(sign: float) -> np.ndarray:
        turned = np.linalg.norm(faces.normals[:, None] - sign * faces.normals, axis=-1)
        return (turned < 2 * _NORMALS) & (np.abs(height[:, None] - sign * height) <= 2 * grain)

    owner = close(1.0).argmax(1)  # the first of them
    for _ in range(len(owner)):
        owner = owner[owner]
    plane = np.where((faces.plane >= 0) & (area > 0), owner[faces.plane] if len(owner) else -1, -1)
    count = len(owner)
    boxes = np.array([(np.full(3, np.inf), np.full(3, -np.inf))] * count).reshape(count, 2, 3)
    longest = np.zeros(count)
    for k in np.unique(owner).tolist():
        its = corners[plane == k]
        boxes[k] = its.min((0, 1)), its.max((0, 1))
        longest[k] = np.abs(its - np.roll(its, 1, axis=1)).max()
    over = (boxes[:, None, 0] <= boxes[:, 1] + grain) & (boxes[:, None, 1] >= boxes[:, 0] - grain)
    kept = np.flatnonzero((owner == np.arange(count)) & ~(close(-1.0) & over.all(2)).any(1))
    number = np.full(count + 1, -1, np.int32)  # the last one: of none
    number[kept] = np.arange(len(kept))
    return FlatFaces(number[plane], faces.normals[kept], longest[kept])


def offsets_at(positions: np.ndarray, triangles: np.ndarray, faces: FlatFaces, shift: np.ndarray) -> np.ndarray:
    """By how much vertices are to be moved so that each plane moves by its `shift` along its normal, float64, shape
    [vertex_count, 3]. Vertices in one place stay in one; by least squares where more than three planes meet.
    """
    rows = np.ascontiguousarray(positions + np.float32(0)).view("V12").ravel()  # -0 becomes 0
    place = np.unique(rows, return_inverse=True)[1].reshape(-1)
    listed = faces.plane >= 0
    pairs = np.column_stack([place[triangles[listed]].reshape(-1), np.repeat(faces.plane[listed], 3)])
    pairs = np.unique(pairs, axis=0)
    offset = np.zeros((int(place.max(initial=-1)) + 1, 3))
    at, begins = np.unique(pairs[:, 0], return_index=True)
    solved: dict[tuple[int, ...], np.ndarray] = {}
    for where, planes in zip(at.tolist(), np.split(pairs[:, 1], begins[1:])):
        key = tuple(planes.tolist())
        if key not in solved:
            moved = np.linalg.lstsq(faces.normals[planes], shift[planes], rcond=0.1)[0]
            size = np.linalg.norm(moved)
            solved[key] = moved * min(1.0, 4 * np.abs(shift[planes]).max() / size) if size > 0 else moved
        offset[where] = solved[key]
    return offset[place]
