"""Curves and points as primitives of three corners, which go wherever triangles go.

A curve is a chain of *segments*: cones between two points, each with its radius, that end where the bisecting plane of
two segments cuts both, so that neighbours meet without a gap and without surfaces inside each other. A segment without
length is a sphere. Only the outside is met: a ray that begins within leaves without a hit (hair closures speak of the
whole fibre, and so does Cycles). A segment may be a *ribbon*: a strip that faces each ray, as wide as the cone, and
shaded as the cone is. It is met where the ray passes its axis, unless that is nearer than its width.

The first two corners of a segment are its points. The third is no point but three words:

    x   both radii: the upper 16 bits of their float32, without the sign, which are 8 bits of mantissa; the first lowest
    y   bits 0 to 21: normal of the plane at the first point; bit 22: the segment is a ribbon
    z   a NaN, which marks that the primitive is a segment: no coordinate of a triangle is one. Bits 0 to 21: normal of
        the plane at the second point

A normal is a point on the octahedron (Meyer, Süssmuth, Sußner, Stamminger and Greiner 2010, "On floating-point normal
vectors"), 11 bits a coordinate. Neighbours have the same radius and the same plane at their joint, as rounded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

RADIUS_BITS, RADIUS_SHIFT = 16, 15
"""Bits of a packed radius, and how far from its lowest bit they begin in a float32."""
RADIUS_MASK = (1 << RADIUS_BITS) - 1
COORDINATE_BITS = 11
"""Bits of a coordinate of a normal."""
COORDINATE_MASK = (1 << COORDINATE_BITS) - 1
NORMAL_STEPS = COORDINATE_MASK
"""Steps of a coordinate of a normal from -1 to 1."""
RIBBON_BIT = 2 * COORDINATE_BITS
SEGMENT_MARK = 0x7FC00000
"""Bits of the NaN that marks a segment."""
SEGMENT_DEFINES = {
    "RADIUS_BITS": RADIUS_BITS,
    "RADIUS_SHIFT": RADIUS_SHIFT,
    "RADIUS_MASK": RADIUS_MASK,
    "COORDINATE_BITS": COORDINATE_BITS,
    "COORDINATE_MASK": COORDINATE_MASK,
    "NORMAL_STEPS": NORMAL_STEPS,
    "RIBBON_BIT": RIBBON_BIT,
    "SEGMENT_MARK": SEGMENT_MARK,
}
"""What native code knows of packed segments."""
BEND_MOST = np.cos(np.radians(60.0))
"""Cosine of half the angle of a bend, in which two segments still share a plane; beyond each ends straight."""
# Segments that are packed together
_BLOCK = 1 << 13
_NORMAL_MASK = np.uint32((1 << 2 * COORDINATE_BITS) - 1)
_RIBBON = np.uint32(1 << RIBBON_BIT)


def pack_segments(
    positions: np.ndarray, radii: np.ndarray, segments: np.ndarray, ribbons: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Corners and triangles of the segments of a mesh.

    Args:
        positions: points [m], float32, shape [n, 3].
        radii: of the points [m], float32, shape [n].
        segments: rows of which the first two numbers are points, int32, shape [m, 3]. Where one begins with the point
            that the row before ends with, it goes on from there.
        ribbons: whether segments are strips that face each ray.

    Returns:
        positions, float32, shape [n + m, 3], and indices into them, int32, shape [m, 3].
    """
    packed = np.empty((len(segments), 3), np.uint32)
    size = (radii.astype(np.float32).view(np.uint32) + np.uint32(1 << RADIUS_SHIFT - 1)) >> np.uint32(RADIUS_SHIFT)
    mark = _RIBBON if ribbons else np.uint32(0)

    def pack(part: slice) -> None:
        first, second = segments[part, 0], segments[part, 1]
        begin, end = _end_normals(positions, segments, part)
        packed[part, 0] = size[first] | size[second] << np.uint32(RADIUS_BITS)
        packed[part, 1] = _packed_normal(begin) | mark
        packed[part, 2] = np.uint32(SEGMENT_MARK) | _packed_normal(end)

    _in_blocks(len(segments), pack)
    count = len(positions)
    corners = np.empty((count + len(segments), 3), np.float32)
    corners[:count], corners[count:] = positions, packed.view(np.float32)
    triangles = np.empty((len(segments), 3), np.int32)
    triangles[:, :2] = segments[:, :2]
    triangles[:, 2] = np.arange(count, len(corners), dtype=np.int32)
    return corners, triangles


def _in_blocks(count: int, work: Callable[[slice], None]) -> None:
    """Do `work` for the parts of `count` rows: parts stay in a core's cache, and threads share them."""
    parts = [slice(first, min(first + _BLOCK, count)) for first in range(0, count, _BLOCK)]
    if len(parts) < 2:
        for part in parts:
            work(part)
        return
    with ThreadPoolExecutor() as pool:
        list(pool.map(work, parts))


def _end_normals(positions: np.ndarray, segments: np.ndarray, part: slice) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Unit normals of the planes at the first and second points of the segments of `part`: their coordinates."""
    low, high = max(part.start - 1, 0), min(part.stop + 1, len(segments))
    first, second = segments[low:high, 0], segments[low:high, 1]
    along = (positions[second].astype(np.float64) - positions[first]).T
    length = np.sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2])
    axis = [each / np.where(length > 0, length, 1) for each in along]
    # the sum of two unit vectors has twice the cosine of half their angle as its length
    bisector = [each[:-1] + each[1:] for each in axis]
    size = np.sqrt(bisector[0] * bisector[0] + bisector[1] * bisector[1] + bisector[2] * bisector[2])
    joined = (second[:-1] == first[1:]) & (size > 2 * BEND_MOST)
    here = slice(part.start - low, part.stop - low)
    begin, end = [], []
    for own, shared in zip(axis, bisector, strict=True):
        between = np.where(joined, shared / np.where(joined, size, 1), 0)
        own_begin, own_end = own.copy(), own.copy()
        own_begin[1:] = np.where(joined, between, own[1:])
        own_end[:-1] = np.where(joined, between, own[:-1])
        begin.append(own_begin[here])
        end.append(own_end[here])
    return begin, end


def are_segments(positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Which primitives are segments: bool, shape [m]."""
    return np.isnan(positions[triangles[:, 2], 2])


def segment_boxes(positions: np.ndarray, segments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest coordinates of packed segments, float32, shape [m, 3] both.

    A segment ends `reach` behind its point at most, where the plane there cuts its cone; the traversal accepts no hit
    farther out than that (`native/traverse/segments/meet.h`).
    """
    least, greatest = np.empty((len(segments), 3), np.float32), np.empty((len(segments), 3), np.float32)

    def enclose(part: slice) -> None:
        least[part], greatest[part] = _boxes(positions, segments[part])

    _in_blocks(len(segments), enclose)
    return least, greatest


def segment_boxes_over(steps: np.ndarray, segments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same of segments whose points, float32, shape [steps, n, 3], move along lines from step to step.

    However a segment turns meanwhile, no hit is farther from the nearer point than twice the largest radius, along the
    axis and across it.
    """
    low, high = np.inf, -np.inf
    for positions in steps:
        ends = positions[segments[:, :2]]
        packed = np.ascontiguousarray(positions[segments[:, 2], 0]).view(np.uint32)
        room = (3 * np.maximum(*_unpacked_radii(packed)))[:, None]  # above the root of 8
        low, high = np.minimum(low, ends.min(1) - room), np.maximum(high, ends.max(1) + room)
    return np.nextafter(low, np.float32(-np.inf)), np.nextafter(high, np.float32(np.inf))


def _boxes(positions: np.ndarray, segments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    ends = positions[segments[:, :2]].astype(np.float64)
    packed = np.ascontiguousarray(positions[segments[:, 2]]).view(np.uint32)
    radius = np.stack(_unpacked_radii(packed[:, 0]), 1).astype(np.float64)
    most = radius.max(1)
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    is_cone = length > 0
    axis = np.divide(along, length[:, None], out=np.zeros_like(along), where=is_cone[:, None])
    taper = np.divide(radius[:, 1] - radius[:, 0], length, out=np.zeros_like(length), where=is_cone)
    low, high = np.full((len(segments), 3), np.inf), np.full((len(segments), 3), -np.inf)
    faces = (packed[:, 1] & _RIBBON) != 0
    for k, outwards in ((0, -taper), (1, taper)):
        normal = _unpacked_normal(packed[:, 1 + k])
        cosine = np.abs((normal * axis).sum(1)) / np.linalg.norm(normal, axis=1)
        tangent = np.sqrt(np.maximum(1 - cosine**2, 0)) / np.maximum(cosine, 1e-3)
        shrink = 1 - outwards * tangent
        reach = np.where(shrink > 0.01, radius[:, k] * tangent / np.maximum(shrink, 0.01), np.inf)
        reach = np.minimum(reach, 2 * most)
        wide = np.minimum(radius[:, k] + np.maximum(outwards, 0) * reach, 2 * most)
        # a disk across the axis, moved along it; of a sphere all of it, and 2 % for roundings of radii and planes
        across = np.sqrt(np.maximum(1 - axis**2, 0))
        half = 1.02 * (wide[:, None] * across + reach[:, None] * np.abs(axis)) + 0.02 * most[:, None]
        half[faces] = 1.02 * most[faces, None]  # seen from any side it ends in the round
        low, high = np.minimum(low, ends[:, k] - half), np.maximum(high, ends[:, k] + half)
    least, greatest = low.astype(np.float32), high.astype(np.float32)
    return np.nextafter(least, np.float32(-np.inf)), np.nextafter(greatest, np.float32(np.inf))


def _packed_normal(normal: Sequence[np.ndarray]) -> np.ndarray:
    """Unit vectors, given by their coordinates, as 22 bits: uint32, shape [m]."""
    x, y, z = normal
    size = np.maximum(np.abs(x) + np.abs(y) + np.abs(z), 1e-30)
    x, y = x / size, y / size
    folded = z < 0
    x, y = (np.where(folded, np.copysign(1 - np.abs(y), x), x), np.where(folded, np.copysign(1 - np.abs(x), y), y))
    steps = [np.rint((value + 1) * (0.5 * NORMAL_STEPS)).astype(np.uint32) for value in (x, y)]
    return steps[0] | steps[1] << np.uint32(COORDINATE_BITS)


def _unpacked_radii(words: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radii at first and second points [m]: float32, shape [m] both."""
    parts = (words & np.uint32(RADIUS_MASK), words >> np.uint32(RADIUS_BITS))
    first, second = ((part << np.uint32(RADIUS_SHIFT)).view(np.float32) for part in parts)
    return first, second


def _unpacked_normal(bits: np.ndarray) -> np.ndarray:
    """The vectors of `_packed_normal`, of any length: float64, shape [m, 3]."""
    bits = bits & _NORMAL_MASK
    x, y = (
        (bits >> np.uint32(shift) & np.uint32(COORDINATE_MASK)).astype(np.float64) * (2 / NORMAL_STEPS) - 1
        for shift in (0, COORDINATE_BITS)
    )
    z = 1 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0)
    return np.stack([x - np.where(x < 0, -fold, fold), y - np.where(y < 0, -fold, fold), z], 1)
