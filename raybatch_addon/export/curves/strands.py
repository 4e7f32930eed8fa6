"""Strands of points with radii as meshes of segments.

A strand is a Catmull-Rom curve through its points, in position and radius, as in Cycles. It is cut into straight
segments, so many that they are off by no more than a share of the radius or of their own length. How many depends on
the strand alone.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import bpy
import numpy as np

from ...core.scene.description import Attribute, Mesh
from ..meshes.mesh_shape import hashed

# A segment may be off the curve by so much of its radius, or of its length
_OFF_RADII, _OFF_LENGTHS = 0.25, 0.005
_PARTS_MOST = 8
# Vertices that are computed together: they stay in a core's cache
_BLOCK = 1 << 14


@dataclass(frozen=True)
class Strands:
    """Points of strands, one strand after the other."""

    points: np.ndarray  # [m], float32, shape [n, 3]
    radii: np.ndarray  # [m], float32, shape [n]
    first: np.ndarray  # first point of each strand, int32, shape [strand_count + 1]
    kept: np.ndarray | None = None  # which of the points given are among them, bool; None: all
    number: np.ndarray | None = None  # of each strand among those given; None: their order
    dropped: str = ""  # why strands or points were left out; empty: none were

    @cached_property
    def strand(self) -> np.ndarray:
        """Strand of each point, int32, shape [n]."""
        return np.repeat(np.arange(len(self.first) - 1, dtype=np.int32), np.diff(self.first))


def sound_strands(points: np.ndarray, radii: np.ndarray, first: np.ndarray) -> Strands:
    """The strands that can be rendered: those of at least two points with numbers that are finite, without points that
    repeat the one before, and with a radius somewhere. `dropped` counts the others.
    """
    radii = np.maximum(radii, 0, dtype=np.float32)
    given = Strands(points, radii, first)
    if len(points) == 0:
        return given
    strand, count = given.strand, len(first) - 1
    finite = np.isfinite(points).all(1) & np.isfinite(radii)
    # a point that repeats the one before makes no segment
    fresh = np.ones(len(points), bool)
    fresh[1:] = (points[1:] != points[:-1]).any(1)
    fresh[first[:-1][first[:-1] < len(points)]] = True
    lengths = np.bincount(strand, weights=fresh, minlength=count)
    bad = np.bincount(strand, weights=~finite, minlength=count) > 0
    thick = np.bincount(strand, weights=np.where(finite, radii, 0), minlength=count) > 0
    sound = ~bad & (lengths >= 2) & thick
    if sound.all() and fresh.all():
        return given
    reasons = [
        f"{int(which.sum()):,} {what}"
        for which, what in (
            (bad, "with points or radii that are not finite"),
            (~bad & (lengths < 2), "without length"),
            (~bad & (lengths >= 2) & ~thick, "without radius"),
        )
        if which.any()
    ]
    kept = fresh & sound[strand]
    sizes = np.bincount(strand[kept], minlength=count)[sound]
    return Strands(
        points[kept],
        radii[kept],
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32),
        kept,
        np.flatnonzero(sound).astype(np.int32),
        ", ".join(reasons),
    )


@dataclass(frozen=True)
class CurveShape:
    """What curves are: round, straight between points, or strips that face each ray."""

    linear: bool = False
    ribbons: bool = False
    parts_most: int = _PARTS_MOST  # segments between two points


@dataclass
class CutStrands:
    """Strands cut into segments, and where their points came from, for values that are given at points."""

    strands: Strands
    shape: CurveShape = CurveShape()

    @cached_property
    def _ends(self) -> np.ndarray:
        """First point of each piece between two points, int64."""
        last = np.zeros(len(self.strands.points), bool)
        last[self.strands.first[1:] - 1] = True
        return np.flatnonzero(~last)

    @cached_property
    def _tangents(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of position and radius at both ends of each piece, float32, shape [pieces, 4] both."""
        k, rows = self._ends, self._rows
        strand = self.strands.strand
        before = np.where((k > 0) & (strand[np.maximum(k - 1, 0)] == strand[k]), k - 1, k)
        behind = np.minimum(k + 2, len(rows) - 1)
        behind = np.where(strand[behind] == strand[k], behind, k + 1)
        half = np.float32(0.5)
        return half * (rows[k + 1] - rows[before]), half * (rows[behind] - rows[k])

    @cached_property
    def _rows(self) -> np.ndarray:
        return np.concatenate([self.strands.points, self.strands.radii[:, None]], 1).astype(np.float32)

    @cached_property
    def _parts(self) -> np.ndarray:
        """Segments of each piece, int64."""
        if self.shape.linear or self.shape.parts_most == 1:
            return np.ones(len(self._ends), np.int64)
        k, rows = self._ends, self._rows
        chord = rows[k + 1] - rows[k]
        begin, end = self._tangents
        # how far tangents lean away from the chord: along it the curve is straight, however its points are spaced
        length = _length(chord)
        square = np.maximum(length * length, 1e-30)
        begin, end = (
            each[:, :3] - chord[:, :3] * (np.einsum("ij,ij->i", each[:, :3], chord[:, :3]) / square)[:, None]
            for each in (begin, end)
        )
        off = (_length(end - begin) + _length(begin + end)) / 8
        may = np.maximum(_OFF_RADII * np.maximum(rows[k, 3], rows[k + 1, 3]), _OFF_LENGTHS * length)
        parts = np.ceil(np.sqrt(off / np.maximum(may, 1e-30)))
        return np.clip(np.nan_to_num(parts, nan=1), 1, self.shape.parts_most).astype(np.int64)

    @cached_property
    def _origin(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of each vertex the piece, how far along it, and the strand. Pieces of a strand follow each other, and its
        last point stands behind them.
        """
        strands, parts = self.strands, self._parts
        # vertices of each piece: the last one of a strand has its end too
        last = np.cumsum(np.diff(strands.first) - 1) - 1
        counts = parts.copy()
        counts[last] += 1
        vertex_first = np.cumsum(counts, dtype=np.int32) - counts.astype(np.int32)
        piece = np.repeat(np.arange(len(parts), dtype=np.int32), counts)
        along = np.arange(len(piece), dtype=np.int32) - vertex_first[piece]
        strand = strands.strand[self._ends][piece]
        return piece, along / parts.astype(np.float32)[piece], strand

    def mesh(self, name: str, uvs: np.ndarray | None = None) -> Mesh:
        """The mesh of all segments; `uvs`: UV coordinates of each strand, float32, shape [strand_count, 2]."""
        positions, radii = self.strands.points, self.strands.radii
        if (self._parts > 1).any():
            positions, radii = self._vertices()
        mesh = Mesh(name, positions, self.segments, radii=radii, ribbons=self.shape.ribbons)
        if uvs is not None:
            of_segment = uvs[self.vertex_strand[self.segments[:, 0]]]
            mesh = replace(mesh, corner_uvs=np.repeat(of_segment[:, None], 3, 1))
        return mesh

    def _vertices(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and radii of all vertices, float32, shape [v, 3] and [v]."""
        rows, ends = self._rows, self._ends
        begin, end = self._tangents
        piece, along, _ = self._origin
        positions, radii = np.empty((len(piece), 3), np.float32), np.empty(len(piece), np.float32)

        def fill(first: int) -> None:
            part = slice(first, first + _BLOCK)
            k, u = piece[part], along[part, None]
            a, b = u * u * (3 - 2 * u), u * (1 - u)  # Hermite's basis
            low = rows[ends[k]]
            at = low + (rows[ends[k] + 1] - low) * a
            at += (begin[k] * (1 - u) - end[k] * u) * b
            positions[part] = at[:, :3]
            np.maximum(at[:, 3], 0, out=radii[part])

        with ThreadPoolExecutor() as pool:
            list(pool.map(fill, range(0, len(piece), _BLOCK)))
        return positions, radii

    def moved(self, points: np.ndarray) -> np.ndarray:
        """Positions of the vertices where the points of the strands are at `points`, float32, shape [n, 3]."""
        if (self._parts == 1).all():
            return points
        other = CutStrands(replace(self.strands, points=points), self.shape)
        other.__dict__.update(_parts=self._parts, _origin=self._origin)  # cut as it was
        return other._vertices()[0]

    @cached_property
    def vertex_strand(self) -> np.ndarray:
        """Strand of each vertex, int32."""
        return self._origin[2]

    @cached_property
    def segments(self) -> np.ndarray:
        """Rows as in `Mesh.triangles`, int32, shape [m, 3]."""
        # all vertices but the last ones of strands
        total = np.concatenate([[0], np.cumsum(self._parts)])[self.strands.first - np.arange(len(self.strands.first))]
        first = np.arange(total[-1], dtype=np.int32)
        first += np.repeat(np.arange(len(total) - 1, dtype=np.int32), np.diff(total))
        rows = np.empty((len(first), 3), np.int32)
        rows[:, 0] = rows[:, 2] = first
        np.add(first, 1, out=rows[:, 1])
        return rows

    def of_points(self, values: np.ndarray) -> np.ndarray:
        """Values of the points given, float32, shape [n, width], as values of the segments' corners."""
        if self.strands.kept is not None:
            values = values[self.strands.kept]
        piece, u, _ = self._origin
        k, u = self._ends[piece], u[:, None]
        return (values[k] * (1 - u) + values[k + 1] * u).astype(np.float32)[self.segments]

    def of_strands(self, values: np.ndarray) -> np.ndarray:
        """Values of the strands that are left, shape [strand_count, width], as values of the segments."""
        return np.ascontiguousarray(values[self.vertex_strand[self.segments[:, 0]]], np.float32)

    def of_given_strands(self, values: np.ndarray) -> np.ndarray:
        """The same of the strands that were given."""
        return self.of_strands(values if self.strands.number is None else values[self.strands.number])

    def hair_value(self, name: str) -> np.ndarray | None:
        """What the node Curves Info says, as values of segments or their corners; None for another name."""
        if name == "is_strand":
            return np.ones((len(self.segments), 1), np.float32)
        if name == "thickness":
            return self._of_kept(2 * self.strands.radii[:, None])
        if name == "random":
            number = self.strands.number
            count = len(self.strands.first) - 1
            return self.of_strands(random_numbers(np.arange(count) if number is None else number)[:, None])
        if name in ("intercept", "length"):
            step = np.zeros(len(self.strands.points))
            step[1:] = np.linalg.norm(np.diff(self.strands.points.astype(np.float64), axis=0), axis=1)
            step[self.strands.first[:-1]] = 0
            total = np.cumsum(step)
            since = total - total[self.strands.first[:-1]][self.strands.strand]
            length = since[self.strands.first[1:] - 1]
            if name == "length":
                return self.of_strands(length[:, None])
            return self._of_kept((since / np.maximum(length, 1e-30)[self.strands.strand])[:, None])
        return None

    def _of_kept(self, values: np.ndarray) -> np.ndarray:
        piece, u, _ = self._origin
        k, u = self._ends[piece], u[:, None]
        return (values[k] * (1 - u) + values[k + 1] * u).astype(np.float32)[self.segments]


def hair_attribute(cut: CutStrands, name: str) -> Attribute | None:
    """The attribute of kind CURVE called `name`."""
    values = cut.hair_value(name)
    return None if values is None else Attribute("CURVE", name, np.ascontiguousarray(values))


def curve_shape(scene: bpy.types.Scene) -> CurveShape:
    """The shape that `scene` says (a setting of Cycles, where its add-on is enabled)."""
    settings = getattr(scene, "cycles_curves", None)
    shape = getattr(settings, "shape", "THICK")
    if shape == "RIBBONS":
        return CurveShape(ribbons=True, parts_most=min(1 << settings.subdivisions, _PARTS_MOST))
    return CurveShape(linear=shape == "THICK_LINEAR")


def _length(rows: np.ndarray) -> np.ndarray:
    x, y, z = rows[:, 0], rows[:, 1], rows[:, 2]
    return np.sqrt(x * x + y * y + z * z)


def random_numbers(numbers: np.ndarray) -> np.ndarray:
    """Random numbers of strands or points, 0..1, as Cycles hashes its number: float32."""
    return (hashed(numbers.astype(np.uint32), words=2) / np.float64(2**32 - 1)).astype(np.float32)
