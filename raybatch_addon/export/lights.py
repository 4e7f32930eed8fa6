"""Blender's lights as the core's `Light`s, in the units of Cycles.

A point or spot light of P watts has the radiant intensity P / (4 pi), whatever its cone; its radius does not follow the
object's scale. An area light has the radiosity P / area, its sizes scaled by the object. A sun's strength is the
irradiance of a surface that faces it. Without `normalize`, power is per area of a sphere or area light (a point of no
radius counts as 4), and a sun's strength is its radiance.
"""

from __future__ import annotations

import functools
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, TypeAlias

import bpy
import numpy as np

from ..core.scene.description import ClosureKind, Light, LightKind, Program, Visibility
from ..core.scene.notice import Notice, Weight, about
from .camera import MatrixKey
from .kept_graphs import KeptGraphs
from .nodes.collections import Collections
from .nodes.compile import compile_graph
from .world import has_nodes, limit_of_bounces, usable_emission

# Light to world and scales, as `_placement` has them
_Place: TypeAlias = tuple[np.ndarray, np.ndarray]

# Columns of a matrix that was composed from rotation and scale in float32 are this close to perpendicular
_SHEAR_MIN = 1e-4


@dataclass(frozen=True)
class LampGraph:
    """The nodes of a light datablock, compiled for all lamps that show it."""

    factor: np.ndarray  # factor of the strength, the same everywhere: linear RGB
    program: Program | None  # another factor of the strength
    notes: tuple[str, ...] = ()  # parts that are left out or approximated
    asked: frozenset[tuple[str, str]] = frozenset()  # kind and name of attributes


class LampGraphs:
    """Graphs of light datablocks, each compiled when a lamp first asks for it.

    A photometric file may be large, and many lamps may share it.
    """

    def __init__(self, collections: Collections | None = None, kept: KeptGraphs | None = None) -> None:
        """`collections` gets the images and attributes that nodes refer to; `kept`: graphs of earlier exports, which
        ask it too.
        """
        self._collections = collections or Collections()
        self._kept = kept or KeptGraphs(self._collections)
        self._known: dict[Hashable, LampGraph] = {}

    def of(self, light: bpy.types.Light) -> LampGraph:
        """The graph of an evaluated light datablock."""
        key = (light.as_pointer(), light.session_uid)
        if key not in self._known:
            self._known[key] = self._graph(light)
        return self._known[key]

    def _graph(self, light: bpy.types.Light) -> LampGraph:
        if not has_nodes(light):
            return LampGraph(np.ones(3), None)
        return self._kept.graph(light, lambda: _lamp_graph(light, self._collections))


def export_light(
    obj: bpy.types.Object, matrix_world, warnings: list[str], graphs: LampGraphs | None = None, random: float = 0.0
) -> Light | None:
    """The light object `obj`, evaluated, with the matrix `matrix_world` (4 x 4).

    `graphs` holds the graphs compiled so far; `random` is the object's random number, 0..1. Of a portal there is a
    place and a shape alone. Returns None, with a line in `warnings`, for a light that cannot be rendered.
    """
    light = obj.data
    name = f"light “{obj.name}”"
    placed = _placement(obj, np.array(matrix_world, float), warnings)
    if placed is None:
        return None
    transform, scale = placed
    emission, values = _shape(light, scale)
    if values is None:
        text = (
            f"{name}: its area is zero, so it gives no light; it is left out. Give it a size and a scale that are not 0"
        )
        warnings.append(Notice(text, Weight.REPAIRED, objects=[obj.name]))
        return None
    if is_portal(obj):
        return Light(obj.name, values["kind"], transform, (0.0, 0.0, 0.0), size=values["size"])
    graph = (graphs or LampGraphs()).of(light)
    warnings += [about(note, name, objects=[obj.name]) for note in graph.notes]
    strength = usable_emission(_strength(light) * graph.factor * emission, name, warnings)
    if graph.program is not None:
        matrix = np.array(matrix_world, np.float32)[:3]
        values |= dict(program=graph.program, object_transform=matrix, info=(*obj.color, float(obj.pass_index), random))
    return Light(
        name=obj.name,
        transform=transform,
        emission=strength,
        visibility=object_visibility(obj),
        casts_shadow=bool(light.use_shadow),
        bounce_max=limit_of_bounces(getattr(light.original, "cycles", None)),
        **values,
    )


def is_portal(obj: bpy.types.Object) -> bool:
    """Whether a light object is a portal: it gives no light, the world is sampled through it."""
    return obj.data.type == "AREA" and getattr(getattr(obj.data, "cycles", None), "is_portal", False)


def object_visibility(obj: bpy.types.Object) -> int:
    """`Visibility` bits of a light: the kinds of rays that meet it, and of scattering that it lights."""
    seen = Visibility.SHADOW
    for kind in ("camera", "diffuse", "glossy", "transmission", "volume_scatter"):
        if getattr(obj, f"visible_{kind}"):
            seen |= Visibility[kind.upper()]
    return int(seen)


def _strength(light: bpy.types.Light) -> np.ndarray:
    """Power or strength by channel, without nodes [W, or W/m² for a sun]."""
    strength = np.array(light.color[:3], float) * light.energy * 2.0 ** getattr(light, "exposure", 0.0)
    if getattr(light, "use_temperature", False):
        strength = strength * np.array(light.temperature_color[:3], float)
    return strength


def _lamp_graph(light: bpy.types.Light, collections: Collections) -> LampGraph:
    """The nodes of `light`, compiled."""
    output = collections.output(light.node_tree)
    if output is None:
        return LampGraph(np.zeros(3), None)
    compiled = compile_graph(output.inputs["Surface"], light, collections)
    asked = frozenset(collections.asked)
    if compiled.program is not None:
        return LampGraph(np.ones(3), compiled.program, compiled.notes, asked)
    factor = sum((np.array(c.weight) for c in compiled.closures if c.kind == ClosureKind.EMISSION), np.zeros(3))
    return LampGraph(factor, None, compiled.notes, asked)


def _shape(light: bpy.types.Light, scale: np.ndarray) -> tuple[float, dict | None]:
    """Factor from strength to `Light.emission`, and the fields of the light's kind; None for a light of zero area."""
    normalize = getattr(light, "normalize", True)
    if light.type in ("POINT", "SPOT"):
        radius = float(light.shadow_soft_size)
        values: dict[str, Any] = dict(kind=LightKind.POINT, radius=radius, soft_falloff=bool(light.use_soft_falloff))
        if light.type == "SPOT":
            width = (float(scale[0] / scale[2]), float(scale[1] / scale[2]))
            values.update(
                kind=LightKind.SPOT, angle=float(light.spot_size), blend=float(light.spot_blend), spot_scale=width
            )
        area = 4 * np.pi * radius**2 if radius > 0 else 4.0
        return (1 if normalize else area) / (4 * np.pi), values
    if light.type == "SUN":
        angle = float(light.angle)
        as_radiance = angle > 0 and not normalize
        return np.pi * np.sin(min(angle, np.pi) / 2) ** 2 if as_radiance else 1.0, dict(kind=LightKind.SUN, angle=angle)
    size_y = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size
    size = (float(light.size * scale[0]), float(size_y * scale[1]))
    is_round = light.shape in ("DISK", "ELLIPSE")
    area = size[0] * size[1] * (np.pi / 4 if is_round else 1)
    if area == 0:
        return 0.0, None
    kind = LightKind.ELLIPSE if is_round else LightKind.RECTANGLE
    return 1 / (np.pi * (area if normalize else 1)), dict(kind=kind, size=size, spread=float(light.spread))


def _placement(obj: bpy.types.Object, matrix: np.ndarray, warnings: list[str]) -> tuple[np.ndarray, np.ndarray] | None:
    """Orthonormal light to world, shape [3, 4], and the scale along its axes, shape [3]; None for a useless matrix."""
    found, text, is_left_out = _placed(obj.data.type, MatrixKey.of(matrix))
    if text:
        weight = Weight.REPAIRED if is_left_out else Weight.REPLACED
        warnings.append(Notice(f"light “{obj.name}”: {text}", weight, objects=[obj.name]))
    return None if found is None else (found[0].copy("K"), found[1].copy())


@functools.lru_cache(maxsize=1024)
def _placed(kind: str, key: MatrixKey) -> tuple[_Place | None, str, bool]:
    """What `_placement` returns for a light of this type and a matrix, what is wrong with that, and whether the light
    is left out.
    """
    matrix = key.matrix()
    if not np.isfinite(matrix).all():
        return None, "its matrix is not finite; it is left out. Reset its location, rotation and scale", True
    columns, position = matrix[:3, :3], matrix[:3, 3]
    scale = np.linalg.norm(columns, axis=0)
    if kind == "POINT":
        return (np.column_stack([np.eye(3), position]).astype(np.float32), np.ones(3)), "", False
    needed = scale if kind == "SPOT" else scale[2:]
    if (needed == 0).any():
        text = "its scale is 0, so that it has no direction; it is left out. Give it a scale that is not 0"
        return None, text, True
    text, unit = "", columns / np.where(scale > 0, scale, 1)
    z = unit[:, 2]
    if kind != "SUN" and max(abs(unit[:, i] @ unit[:, j]) for i, j in ((0, 1), (0, 2), (1, 2))) > _SHEAR_MIN:
        text = "it is sheared, which is not supported; it keeps its direction and sizes at right angles"
    x = unit[:, 0] - (unit[:, 0] @ z) * z
    if np.linalg.norm(x) < _SHEAR_MIN:
        x = np.cross(unit[:, 1], z)
    if np.linalg.norm(x) < _SHEAR_MIN:
        x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return (np.column_stack([x, np.cross(z, x), z, position]).astype(np.float32), scale), text, False
