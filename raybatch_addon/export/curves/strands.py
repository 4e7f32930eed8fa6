"""Strands of points with radii as meshes of segments.

A strand is a Catmull-Rom curve through its points, in position and radius, as in Cycles. It is cut into straight
segments, so many that they are off by no more than a share of the radius or of their own length. How many depends on
the strand alone.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import bpy
import numpy as np

from ...core.scene.description import Attribute, Mesh
from ..lookup3 import lookup3

# A segment may be off the curve by so much of its radius, or of its length
_OFF_RADII, _OFF_LENGTHS = 0.25, 0.005
_PARTS_MOST = 8
# Points that are looked at together: what is computed of them stays in a core's cache
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
    finite = np.isfinite(radii)
    # a point that repeats the one before makes no segment
    fresh = np.zeros(len(points), bool)
    for column in points.T:  # by one: numpy goes slowly along axes of three
        finite &= np.isfinite(column)
        fresh[1:] |= column[1:] != column[:-1]
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


def without_radius(count: int) -> Strands:
    """What is left of so many strands that have no radius anywhere."""
    none = np.zeros(0, np.float32)
    dropped = f"{count:,} without radius" if count else ""
    return Strands(none.reshape(0, 3), none, np.zeros(1, np.int32), dropped=dropped)


@dataclass(frozen=True)
class CurveShape:
    """The shape that curves are given: round, straight between points, or strips that face each ray."""

    linear: bool = False
    ribbons: bool = False
    parts_most: int = _PARTS_MOST  # segments between two points


@dataclass
class CutStrands:
    """Strands cut into segments, and where their points came from, for values that are given at points."""

    strands: Strands
    shape: CurveShape = CurveShape()

    @cached_property
    def _last(self) -> np.ndarray:
        """Last point of each strand."""
        return self.strands.first[1:] - 1

    @cached_property
    def _columns(self) -> np.ndarray:
        """x, y, z and radius of the points, float32, shape [4, n]."""
        columns = np.empty((4, len(self.strands.points)), np.float32)
        columns[:3], columns[3] = self.strands.points.T, self.strands.radii
        return columns

    @cached_property
    def _tangents(self) -> np.ndarray:
        """Derivatives of position and radius at the points, float32, shape [4, n]."""
        columns, first, last = self._columns, self.strands.first[:-1], self._last
        tangents = np.empty_like(columns)
        np.subtract(columns[:, 2:], columns[:, :-2], out=tangents[:, 1:-1])
        tangents[:, first] = columns[:, first + 1] - columns[:, first]
        tangents[:, last] = columns[:, last] - columns[:, last - 1]
        tangents *= np.float32(0.5)
        return tangents

    @cached_property
    def _parts(self) -> np.ndarray:
        """Segments of the piece from each point to the next, int64; 0 behind the last points of strands."""
        columns, count = self._columns, len(self.strands.points)
        parts = np.ones(count, np.int64)
        if not (self.shape.linear or self.shape.parts_most == 1):
            tangents = self._tangents  # before threads ask for them

            def cut(first: int) -> None:
                here = slice(first, min(first + _BLOCK, count - 1))
                there = slice(here.start + 1, here.stop + 1)
                with np.errstate(over="ignore", invalid="ignore"):  # from strand to strand, where nothing is cut
                    off, length = _off_chord(
                        columns[:3, there] - columns[:3, here], tangents[:3, here], tangents[:3, there]
                    )
                    radius = np.maximum(columns[3, here], columns[3, there])
                    may = np.maximum(_OFF_RADII * radius, _OFF_LENGTHS * length)
                    wanted = np.ceil(np.sqrt(off / np.maximum(may, 1e-30)))
                parts[here] = np.clip(np.nan_to_num(wanted, nan=1), 1, self.shape.parts_most)

            _in_blocks(count - 1, cut)
        parts[self._last] = 0
        return parts

    @cached_property
    def _vertex_first(self) -> np.ndarray:
        """First vertex of the piece behind each point, int64, shape [n + 1]. The last piece of a strand has its end
        too, and there is none behind its last point.
        """
        counts = self._parts.copy()
        counts[self._last - 1] += 1
        return np.concatenate([[0], np.cumsum(counts)])

    def _origin_of(self, first: int, end: int) -> tuple[np.ndarray, np.ndarray]:
        """The piece of each vertex behind the points from `first` to `end`, and how far along it the vertex is."""
        begin = self._vertex_first[first : end + 1]
        counts = np.diff(begin)
        piece = np.repeat(np.arange(first, end), counts)
        along = np.arange(begin[0], begin[-1]) - np.repeat(begin[:-1], counts)
        return piece, along / np.repeat(self._parts[first:end], counts)

    @cached_property
    def _origin(self) -> tuple[np.ndarray, np.ndarray]:
        return self._origin_of(0, len(self.strands.points))

    def mesh(self, name: str) -> Mesh:
        """The mesh of all segments."""
        positions, radii = self.strands.points, self.strands.radii
        if self._is_cut:
            positions, radii = self._vertices()
        return Mesh(name, positions, self.segments, radii=radii, ribbons=self.shape.ribbons)

    def corner_uvs(self, uvs: np.ndarray) -> np.ndarray:
        """UV coordinates as in `Mesh.corner_uvs`, from those of each strand, float32, shape [strand_count, 2]."""
        of_segment = uvs[self.vertex_strand[self.segments[:, 0]]]
        return np.repeat(of_segment[:, None], 3, 1)

    @property
    def _is_cut(self) -> bool:
        return bool((self._parts > 1).any())

    def _vertices(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and radii of all vertices, float32, shape [v, 3] and [v]."""
        columns, tangents, first = self._columns, self._tangents, self._vertex_first
        count = len(self.strands.points)
        positions, radii = np.empty((first[-1], 3), np.float32), np.empty(first[-1], np.float32)

        def fill(begin: int) -> None:
            end = min(begin + _BLOCK // 2, count)
            part = slice(first[begin], first[end])
            k, u = self._origin_of(begin, end)
            a, b = u * u * (3 - 2 * u), u * (1 - u)  # Hermite's basis
            left = 1 - u
            for i in range(4):
                low = columns[i].take(k)
                at = (columns[i].take(k + 1) - low) * a
                at += low
                at += (tangents[i].take(k) * left - tangents[i].take(k + 1) * u) * b
                if i < 3:
                    positions[part, i] = at
                else:
                    np.maximum(at, 0, out=radii[part], casting="same_kind")

        _in_blocks(count, fill, _BLOCK // 2)
        return positions, radii

    def moved(self, points: np.ndarray) -> np.ndarray:
        """Positions of the vertices where the points of the strands are at `points`, float32, shape [n, 3]."""
        if not self._is_cut:
            return points
        other = CutStrands(replace(self.strands, points=points), self.shape)
        other.__dict__.update(_parts=self._parts, _vertex_first=self._vertex_first)  # cut as it was
        return other._vertices()[0]

    @cached_property
    def vertex_strand(self) -> np.ndarray:
        """Strand of each vertex, int32."""
        return self.strands.strand[self._origin[0]]

    @cached_property
    def segments(self) -> np.ndarray:
        """Rows as in `Mesh.triangles`, int32, shape [m, 3]."""
        # all vertices but the last ones of strands
        total = np.concatenate([[0], np.cumsum(self._parts)])[self.strands.first]
        rows = np.empty((total[-1], 3), np.int32)

        def number(first: int) -> None:
            sizes = np.diff(total[first : first + _BLOCK // 4 + 1])
            strands = np.arange(first, first + len(sizes), dtype=np.int32)
            part = slice(total[first], total[first] + sizes.sum())
            begin = np.arange(part.start, part.stop, dtype=np.int32)
            begin += np.repeat(strands, sizes)
            rows[part, 0] = rows[part, 2] = begin
            np.add(begin, 1, out=rows[part, 1])

        _in_blocks(len(total) - 1, number, _BLOCK // 4)
        return rows

    def of_points(self, values: np.ndarray) -> np.ndarray:
        """Values of the points given, float32, shape [n, width], as values of the segments' corners."""
        if self.strands.kept is not None:
            values = values[self.strands.kept]
        k, u = self._origin
        u = u[:, None]
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
        k, u = self._origin
        u = u[:, None]
        return (values[k] * (1 - u) + values[k + 1] * u).astype(np.float32)[self.segments]


def hair_attribute(cut: CutStrands, name: str) -> Attribute | None:
    """The attribute of kind CURVE called `name`."""
    values = cut.hair_value(name)
    return None if values is None else Attribute("CURVE", name, np.ascontiguousarray(values))


def curve_shape(scene: bpy.types.Scene) -> CurveShape:
    """The shape that `scene` says (a setting of Cycles, where its add-on is enabled)."""
    settings = getattr(scene, "cycles_curves", None)
    shape = getattr(settings, "shape", "THICK")
    if settings is not None and shape == "RIBBONS":
        return CurveShape(ribbons=True, parts_most=min(1 << settings.subdivisions, _PARTS_MOST))
    return CurveShape(linear=shape == "THICK_LINEAR")


def _off_chord(chord: np.ndarray, begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far a curve leaves its `chord`, and the chord's length [m], by the derivatives at both ends; columns."""
    square = _dot(chord, chord)
    least = np.maximum(square, np.float32(1e-30))
    # how far tangents lean away from the chord: along it the curve is straight, however its points are spaced
    begin, end = (each - chord * (_dot(each, chord) / least) for each in (begin, end))
    apart, sum_of = end - begin, begin + end
    return (np.sqrt(_dot(apart, apart)) + np.sqrt(_dot(sum_of, sum_of))) / 8, np.sqrt(square)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _in_blocks(count: int, work: Callable[[int], None], size: int = _BLOCK) -> None:
    """Do `work` from each block of `size` of `count` on."""
    with ThreadPoolExecutor() as pool:
        list(pool.map(work, range(0, count, size)))


def random_numbers(numbers: np.ndarray) -> np.ndarray:
    """Random numbers of strands or points, 0..1, as Cycles hashes its number: float32."""
    return (lookup3(numbers.astype(np.uint32), words=2) / np.float64(2**32 - 1)).astype(np.float32)
