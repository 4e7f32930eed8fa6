"""Blender's curves, particle hair and point clouds, evaluated, as meshes of segments with attributes."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import chain

import bpy
import numpy as np

from ...core.scene.description import Attribute, Mesh
from ...core.scene.notice import Notice, Weight
from ..images.color_spaces import linear_colors
from ..meshes.attributes import ATTRIBUTE_TYPES, finite_values
from ..meshes.mesh_arrays import read
from ..meshes.meshes import point_velocity
from .kept_strands import mesh_of
from .strands import CurveShape, CutStrands, Strands, hair_attribute, random_numbers, sound_strands, without_radius

# What Cycles takes where curves, and points, have no radius [m]
_CURVE_RADIUS, _POINT_RADIUS = 0.005, 0.01
# Kind of the attributes that Curves Info and Point Info read: only segments have them
STRAND_KIND = "CURVE"


class _Source(ABC):
    """A data-block whose segments have attributes."""

    def attributes(self, asked: Iterable[tuple[str, str]], user: str, warnings: list[str]) -> list[Attribute]:
        """Attributes of kind and name `asked`, as far as it has them; `warnings` counts what is not finite of them and
        names the object `user`.
        """
        found = [each for kind, name in asked if (each := self._attribute(kind, name)) is not None]
        where = f"object “{user}”: {{}} of attribute “%s” of its strands or points"
        return [replace(each, values=finite_values(each.values, where % each.name, user, warnings)) for each in found]

    @abstractmethod
    def _attribute(self, kind: str, name: str) -> Attribute | None: ...


class CurvesSource(_Source):
    """A Curves data-block."""

    def __init__(self, curves: bpy.types.Curves, user: str, shape: CurveShape) -> None:
        self._curves, self._user = curves, user
        count = len(curves.position_data)
        points = read(curves.position_data, "vector", np.float32, count, 3)
        # an empty data-block says that it has an offset, and does not give it
        offsets = curves.curve_offset_data
        first = read(offsets, "value", np.int32, len(offsets)) if count else np.zeros(1, np.int32)
        self._first, self._notes = first, list[str]()
        radii = self._adapted("radius", "POINT")
        radii = np.full(count, _CURVE_RADIUS, np.float32) if radii is None else radii[:, 0]
        self._cut = CutStrands(sound_strands(points, radii, first), shape)

        self._given = count

    def _adapted(self, name: str, domain: str) -> np.ndarray | None:
        """The attribute `name` for points or curves, carried over from the other domain as Blender does it; None where
        there is none of numbers.
        """
        attribute = self._curves.attributes.get(name)
        values = None if attribute is None else _values(attribute)
        if values is None or attribute.domain == domain:
            if attribute is not None and values is None:
                self._notes.append(f"attribute “{name}” is no number, and is not used")
            return values
        sizes = np.diff(self._first)
        if domain == "POINT":
            self._notes.append(f"attribute “{name}” is given for curves, and all points of each have it")
            return np.repeat(values, sizes, axis=0)
        self._notes.append(f"attribute “{name}” is given for points, and curves have its mean")
        sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, 0, np.float64)])[self._first]
        return (np.diff(sums, axis=0) / np.maximum(sizes, 1)[:, None]).astype(np.float32)

    def vertices_of(self, obj: bpy.types.Object) -> np.ndarray | None:
        """Positions of the vertices of the mesh as `obj`, evaluated at another time, has them; None where it has other
        points then.
        """
        count = len(obj.data.position_data) if isinstance(obj.data, bpy.types.Curves) else -1
        if count != self._given:
            return None
        return _moved(self._cut, read(obj.data.position_data, "vector", np.float32, count, 3))

    def velocity(self, warnings: list[str]) -> np.ndarray | None:
        """Velocity of the vertices [m/s], float32, shape [vertex_count, 3]; None without the attribute “velocity”, and
        where `warnings` says what is wrong with it.
        """
        values = point_velocity(self._curves, self._given, self._user, warnings)
        if values is None:
            return None
        points, kept = self._cut.strands.points, self._cut.strands.kept
        return self._cut.moved(points + (values if kept is None else values[kept])) - self._cut.moved(points)

    def exported(self, uvs_asked: bool, warnings: list[str]) -> Mesh | None:
        """The mesh of the curves; None where nothing of it can be rendered."""
        strands = self._cut.strands
        _warn_dropped(strands, f"object “{self._user}”: curves", self._user, warnings)
        if len(strands.points) == 0:
            return None
        uvs = self._surface_uvs() if uvs_asked else None
        mesh = mesh_of(self._cut, self._curves.name, self._user, uvs)
        slots = self._adapted("material_index", "CURVE")
        warnings += [f"object “{self._user}”: {each}" for each in self._notes]
        if slots is None or not slots.any() or len(self._curves.materials) < 2:
            return mesh
        slot = np.clip(np.rint(slots), 0, len(self._curves.materials) - 1)
        of_segment = self._cut.of_given_strands(slot)[:, 0].astype(np.int32)
        return replace(mesh, triangle_slot=of_segment)

    def _surface_uvs(self) -> np.ndarray | None:
        values = self._adapted("surface_uv_coordinate", "CURVE")
        if values is None or values.shape[1] != 2:
            return None
        number = self._cut.strands.number
        return np.nan_to_num(values if number is None else values[number])

    def _attribute(self, kind: str, name: str) -> Attribute | None:
        if kind == STRAND_KIND and name == "normal":
            # one by one: `foreach_get` reads memory here that Blender has freed already
            each = chain.from_iterable(normal.vector for normal in self._curves.normals)
            normals = np.fromiter(each, np.float32, 3 * self._given).reshape(-1, 3)
            return Attribute(kind, name, np.ascontiguousarray(np.nan_to_num(self._cut.of_points(normals))))
        if kind == STRAND_KIND:
            return hair_attribute(self._cut, name)
        attribute = self._curves.attributes.get(name) if name else None
        if attribute is None or kind == "TANGENT":
            return None
        values = _values(attribute)
        if values is None:
            return None
        of = self._cut.of_points if attribute.domain == "POINT" else self._cut.of_given_strands
        return Attribute(kind, name, of(values))


class ParticleHair(_Source):
    """The hair of a particle system, as the evaluated object `owner` wears it."""

    def __init__(
        self, owner: bpy.types.Object, modifier: bpy.types.ParticleSystemModifier, shape: CurveShape, viewport: bool
    ) -> None:
        """`viewport`: the depsgraph of `owner` is that of the viewport."""
        self._owner, self._modifier, self._system = owner, modifier, modifier.particle_system
        self._viewport = viewport
        self._name, settings = modifier.name, self._system.settings
        if _has_width(settings):
            points, first = _paths(owner, self._system, viewport)
            self._count, self._given = len(first) - 1, len(points)
            strands = sound_strands(points, _radii(settings, points, first), first)
        else:  # wherever its points are, which Blender takes long to give
            self._count, self._given = len(_strand_numbers(self._system)), 0
            strands = without_radius(self._count)
        self._cut = CutStrands(strands, shape)

    def vertices_of(self, obj: bpy.types.Object) -> np.ndarray | None:
        """See `CurvesSource.vertices_of`."""
        modifier = obj.modifiers.get(self._name)
        if modifier is None or modifier.type != "PARTICLE_SYSTEM":
            return None
        points, _ = _paths(obj, modifier.particle_system, self._viewport)
        return _moved(self._cut, points) if len(points) == self._given else None

    def velocity(self, warnings: list[str]) -> None:
        """Particle hair has none."""

    def exported(self, uvs_asked: bool, warnings: list[str]) -> Mesh | None:
        """The mesh of the hair; None where there is none."""
        strands = self._cut.strands
        name = f"{self._owner.name}/{self._system.name}"
        _warn_dropped(strands, f"particle hair “{name}”: strands", self._owner.name, warnings)
        if len(strands.points) == 0:
            return None
        return mesh_of(self._cut, name, self._owner.name, self._emitter_uvs() if uvs_asked else None)

    def _emitter_uvs(self, name: str = "") -> np.ndarray | None:
        """UV coordinates of the emitter's surface where each strand grows, in the map called `name`, or that which is
        marked for rendering.
        """
        layers = self._owner.data.uv_layers if isinstance(self._owner.data, bpy.types.Mesh) else ()
        which = next((i for i, each in enumerate(layers) if (each.name == name if name else each.active_render)), None)
        if which is None:
            return None
        return self._at_roots(functools.partial(self._system.uv_on_emitter, self._modifier, uv_no=which), 2)

    def _emitter_colors(self, name: str) -> np.ndarray | None:
        """RGBA of the emitter's faces where each strand grows; None where they are not stored as Blender can give
        them, as bytes at corners.
        """
        colors = self._owner.data.color_attributes if isinstance(self._owner.data, bpy.types.Mesh) else ()
        names = [each.name for each in colors if each.data_type == "BYTE_COLOR" and each.domain == "CORNER"]
        if name not in names:
            return None
        asked = functools.partial(self._system.mcol_on_emitter, self._modifier, vcol_no=names.index(name))
        values = self._at_roots(asked, 3)
        if values is None:
            return None
        return np.concatenate([linear_colors(values), np.ones((len(values), 1), np.float32)], 1)

    def _at_roots(self, asked: Callable[..., Iterable[float]], width: int) -> np.ndarray | None:
        """What Blender gives of the emitter's surface at the root of each strand that is left, float32, shape
        [strand_count, width].
        """
        particles, system = self._system.particles, self._system
        if len(particles) == 0:
            return None
        begin = _first_strand(system)
        number = range(self._count) if self._cut.strands.number is None else self._cut.strands.number.tolist()
        parents = list(particles)
        last = parents[-1]
        values = (
            asked(particle=parents[begin + i] if begin + i < len(parents) else last, particle_no=begin + i)
            for i in number
        )
        return np.fromiter(chain.from_iterable(values), np.float32, width * len(number)).reshape(-1, width)

    def _attribute(self, kind: str, name: str) -> Attribute | None:
        if kind == STRAND_KIND:
            return hair_attribute(self._cut, name)
        if kind not in ("GEOMETRY", "COLOR") or not name:
            return None
        values = self._emitter_colors(name)
        if values is None and kind == "GEOMETRY":
            values = self._emitter_uvs(name)
        return None if values is None else Attribute(kind, name, self._cut.of_strands(values))


class PointsSource(_Source):
    """A point cloud: spheres."""

    def __init__(self, cloud: bpy.types.PointCloud, user: str) -> None:
        self._cloud, self._user = cloud, user
        count = len(cloud.points)
        points = read(cloud.points, "co", np.float32, count, 3)
        radii = _stored(cloud, "radius", count)
        radii = np.full(count, _POINT_RADIUS, np.float32) if radii is None else radii[:, 0]
        self._kept = np.isfinite(points).all(1) & np.isfinite(radii) & (radii > 0)
        self._points, self._radii = points[self._kept], radii[self._kept]

    def vertices_of(self, obj: bpy.types.Object) -> np.ndarray | None:
        """See `CurvesSource.vertices_of`."""
        count = len(obj.data.points) if isinstance(obj.data, bpy.types.PointCloud) else -1
        if count != len(self._kept):
            return None
        points = read(obj.data.points, "co", np.float32, count, 3)[self._kept]
        return points if np.isfinite(points).all() else None

    def velocity(self, warnings: list[str]) -> np.ndarray | None:
        """See `CurvesSource.velocity`."""
        values = point_velocity(self._cloud, len(self._kept), self._user, warnings)
        return None if values is None else values[self._kept]

    def exported(self, uvs_asked: bool, warnings: list[str]) -> Mesh | None:
        """The mesh of the points; None where there are none."""
        lost = len(self._kept) - len(self._points)
        if lost:
            text = f"{lost:,} points without radius, or with numbers that are not finite, are left out"
            warnings.append(Notice(f"object “{self._user}”: {text}", Weight.REPAIRED, objects=[self._user]))
        if len(self._points) == 0:
            return None
        number = np.arange(len(self._points), dtype=np.int32)
        return Mesh(self._cloud.name, self._points, np.stack([number] * 3, 1), radii=self._radii)

    def _attribute(self, kind: str, name: str) -> Attribute | None:
        values = {
            "point_position": lambda: self._points,
            "point_radius": lambda: self._radii[:, None],
            "point_random": self._random,
        }
        if kind == STRAND_KIND:
            return Attribute(kind, name, np.ascontiguousarray(values[name]())) if name in values else None
        attribute = self._cloud.attributes.get(name) if name else None
        found = None if attribute is None or kind == "TANGENT" else _values(attribute)
        if found is None:
            return None
        return Attribute(kind, name, found[self._kept])

    def _random(self) -> np.ndarray:
        return random_numbers(np.flatnonzero(self._kept))[:, None]


Source = CurvesSource | ParticleHair | PointsSource


def _moved(cut: CutStrands, points: np.ndarray) -> np.ndarray | None:
    points = points if cut.strands.kept is None else points[cut.strands.kept]
    return cut.moved(points) if np.isfinite(points).all() else None


def _warn_dropped(strands: Strands, what: str, user: str, warnings: list[str]) -> None:
    if strands.dropped:
        warnings.append(Notice(f"{what} are left out: {strands.dropped}", Weight.REPAIRED, objects=[user]))


def _values(attribute: bpy.types.Attribute) -> np.ndarray | None:
    """All values of an attribute, float32, shape [n, width]; None for types that are no numbers."""
    if attribute.data_type not in ATTRIBUTE_TYPES:
        return None
    name, dtype, width = ATTRIBUTE_TYPES[attribute.data_type]
    return read(attribute.data, name, dtype, len(attribute.data), width).reshape(-1, width).astype(np.float32)


def _stored(owner: bpy.types.ID, name: str, count: int) -> np.ndarray | None:
    """The attribute `name` of `count` elements, or None."""
    attribute = owner.attributes.get(name)
    values = None if attribute is None else _values(attribute)
    return values if values is not None and len(values) == count else None


# --- particle hair


def _first_strand(system: bpy.types.ParticleSystem) -> int:
    """Number of the first strand that is rendered: children have numbers behind their parents', which Cycles leaves out
    wherever there are children.
    """
    has_children = system.settings.child_type != "NONE" and len(system.child_particles) > 0
    return len(system.particles) if has_children else 0


def _strand_numbers(system: bpy.types.ParticleSystem) -> range:
    """Numbers of all strands that are rendered."""
    children = 0 if system.settings.child_type == "NONE" else len(system.child_particles)
    return range(_first_strand(system), len(system.particles) + children)


def _has_width(settings: bpy.types.ParticleSettings) -> bool:
    """Whether strands have a radius anywhere."""
    return settings.radius_scale != 0 and (settings.root_radius != 0 or settings.tip_radius != 0)


def _paths(owner: bpy.types.Object, system: bpy.types.ParticleSystem, viewport: bool) -> tuple[np.ndarray, np.ndarray]:
    """Points of all strands in the object's space [m], and the first of each.

    Blender gives one point a call, and nothing else: 0.4 microseconds each, a third more without a tuple of it.
    """
    settings, numbers = system.settings, _strand_numbers(system)
    plain = steps = (1 << (settings.display_step if viewport else settings.render_step)) + 1
    if settings.kink == "SPIRAL":
        steps += settings.kink_extra_steps
    count, asked = len(numbers), system.co_hair
    values = (asked(owner, particle_no=i, step=k)[:] for i in numbers for k in range(steps))
    points = np.fromiter(chain.from_iterable(values), np.float32, 3 * count * steps).reshape(-1, 3)
    of_steps = points.reshape(count, steps, 3)
    # A strand that has no such step ends before it: Blender gives zeros there, and nothing that tells them from a point
    # at the world's origin, so that such a point, if one of the extra steps is there, gives way to the one before it
    for k in range(plain, steps):
        lacking = ~of_steps[:, k].any(1)
        of_steps[lacking, k] = of_steps[lacking, k - 1]
    inverse = np.array(owner.matrix_world.inverted_safe(), np.float64)
    points = (points @ inverse[:3, :3].T + inverse[:3, 3]).astype(np.float32)
    return points, np.arange(0, count * steps + 1, steps, dtype=np.int32)


def _radii(settings: bpy.types.ParticleSettings, points: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Radii along strands [m], as Cycles shapes them."""
    strands = Strands(points, np.zeros(len(points), np.float32), first)
    intercept = np.zeros(len(points))
    if len(points):
        step = np.zeros(len(points))
        step[1:] = np.linalg.norm(np.diff(points.astype(np.float64), axis=0), axis=1)
        step[first[:-1]] = 0
        total = np.cumsum(step)
        since = total - total[first[:-1]][strands.strand]
        intercept = since / np.maximum(since[first[1:] - 1], 1e-30)[strands.strand]
    left, shape = np.clip(1 - intercept, 0, 1), settings.shape
    if shape:
        left = left ** (1 + shape if shape < 0 else 1 / max(1 - shape, 1e-6))
    scale = settings.radius_scale * 0.5
    radii = left * scale * (settings.root_radius - settings.tip_radius) + scale * settings.tip_radius
    if settings.use_close_tip and len(points):
        radii[first[1:] - 1] = 0
    return radii.astype(np.float32)


def hair_systems(obj: bpy.types.Object, viewport: bool) -> list[bpy.types.ParticleSystemModifier]:
    """Modifiers of the particle systems whose hair is rendered as strands."""
    return [
        modifier
        for modifier in obj.modifiers
        if modifier.type == "PARTICLE_SYSTEM"
        and (modifier.show_viewport if viewport else modifier.show_render)
        and modifier.particle_system.settings.type == "HAIR"
        and modifier.particle_system.settings.render_type == "PATH"
    ]
