"""Attributes of Blender's meshes, objects and view layers, as shader programs read them.

Kinds of a mesh's attributes, and their names:
- GEOMETRY: by name, as Cycles finds it; also `uv`, `vertex_color`, `pointiness`, `random_per_island`.
- GRID: a grid of a volume; meshes have none, and need none.
- COLOR: a colour attribute; without name the one that is marked for rendering.
- TANGENT: tangents and the signs of bitangents of a UV map; without name the one that is marked for rendering.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy
import numpy as np

from ...core.scene.description import Attribute
from ...core.scene.notice import Notice, Weight
from .mesh_arrays import MeshArrays, read
from .mesh_shape import pointiness, random_per_island
from .tangents import corner_tangents

# By Blender's type of an attribute: the property that `foreach_get` reads, and the count of numbers
ATTRIBUTE_TYPES = {
    "FLOAT": ("value", np.float32, 1),
    "INT": ("value", np.int32, 1),
    "INT8": ("value", np.int32, 1),
    "BOOLEAN": ("value", bool, 1),
    "FLOAT2": ("vector", np.float32, 2),
    "FLOAT_VECTOR": ("vector", np.float32, 3),
    "FLOAT_COLOR": ("color", np.float32, 4),
    "BYTE_COLOR": ("color", np.float32, 4),
    "QUATERNION": ("value", np.float32, 4),
}


def mesh_attributes(
    mesh: bpy.types.Mesh, asked: Iterable[tuple[str, str]], user: str, warnings: list[str]
) -> list[Attribute]:
    """Attributes of `mesh` among those of kind and name `asked`.

    `warnings` names the attributes that the mesh lacks, and the object `user`.
    """
    arrays = MeshArrays(mesh)
    found = []
    for kind, name in asked:
        if kind == "GRID":
            continue
        values = _READERS[kind](arrays, name)
        if values is None:
            what = lacking_attribute(kind, name)
            warnings.append(f"object “{user}”: its mesh “{mesh.name}” has no {what}, which its material asks for")
            continue
        where = f"object “{user}”: {{}} of attribute “{name}” of its mesh “{mesh.name}”"
        values = finite_values(values, where, user, warnings)
        found.append(Attribute(kind, name, values))
    return found


def finite_values(values: np.ndarray, where: str, user: str, warnings: list[str]) -> np.ndarray:
    """`values` as float32, with 0 in place of those that are not finite.

    `warnings` counts these in the place of {} in `where`, and names the object `user`.
    """
    values = np.ascontiguousarray(values, np.float32)
    finite = np.isfinite(values)
    if finite.all():
        return values
    text = where.format(f"{values.size - np.count_nonzero(finite):,} numbers") + " are not finite; they are 0"
    warnings.append(Notice(text, Weight.REPAIRED, objects=[user]))
    return np.where(finite, values, np.float32(0))


def lacking_attribute(kind: str, name: str) -> str:
    """An attribute of geometry that is not there, in words."""
    return _MISSING[kind].format(name=name) if name else _UNNAMED[kind]


def _by_name(arrays: MeshArrays, name: str) -> np.ndarray | None:
    if name in _STANDARD:
        return _STANDARD[name](arrays)
    return _of_blender(arrays, name)


def _of_blender(arrays: MeshArrays, name: str) -> np.ndarray | None:
    attribute = arrays.mesh.attributes.get(name) if name else None
    if attribute is None or attribute.data_type not in ATTRIBUTE_TYPES:
        return None
    prop, dtype, width = ATTRIBUTE_TYPES[attribute.data_type]
    if len(attribute.data) == 0:
        return None
    values = read(attribute.data, prop, dtype, len(attribute.data), width).reshape(-1, width).astype(np.float32)
    if attribute.domain == "EDGE":
        return arrays.of_points(_edges_to_points(arrays, values, attribute.data_type == "BOOLEAN"))
    if attribute.domain == "POINT":
        return arrays.of_points(values)
    if attribute.domain == "CORNER":
        return values[arrays.loops]
    return values[arrays.polygons] if attribute.domain == "FACE" else None


def _edges_to_points(arrays: MeshArrays, values: np.ndarray, any_of_them: bool) -> np.ndarray:
    """Means of the edges at each point, or whether any of the edges is true."""
    total, count = np.zeros((len(arrays.mesh.vertices), values.shape[1])), np.zeros((len(arrays.mesh.vertices), 1))
    for end in arrays.edges.T:
        np.add.at(total, end, values)
        np.add.at(count, end, 1)
    return (total > 0) if any_of_them else total / np.maximum(count, 1)


def _color(arrays: MeshArrays, name: str) -> np.ndarray | None:
    if not name:
        colors = arrays.mesh.color_attributes
        index = colors.render_color_index
        name = colors[index].name if 0 <= index < len(colors) else ""
    return _of_blender(arrays, name)


def _active_uv(arrays: MeshArrays) -> np.ndarray | None:
    layer = uv_layer(arrays.mesh, "")
    return None if layer is None else arrays.uvs(layer)


def uv_layer(mesh: bpy.types.Mesh, name: str) -> Any:
    """The UV map called `name`; without name the one that is marked for rendering; None if there is none."""
    if name:
        return mesh.uv_layers.get(name)
    return next((layer for layer in mesh.uv_layers if layer.active_render), None)


def _tangent(arrays: MeshArrays, name: str) -> np.ndarray | None:
    layer = uv_layer(arrays.mesh, name)
    if layer is None:
        return None
    return corner_tangents(arrays.positions[arrays.triangles], arrays.corner_normals, arrays.uvs(layer))


_STANDARD = {
    "uv": _active_uv,
    "vertex_color": lambda arrays: _color(arrays, ""),
    "pointiness": lambda arrays: arrays.of_points(
        pointiness(arrays.positions, arrays.vertex_normals, arrays.edges)[:, None]
    ),
    "random_per_island": lambda arrays: random_per_island(len(arrays.positions), arrays.edges)[arrays.triangles[:, 0]][
        :, None
    ],
}
_READERS = {"GEOMETRY": _by_name, "COLOR": _color, "TANGENT": _tangent}
_MISSING = {
    "GEOMETRY": "attribute “{name}”",
    "COLOR": "colour attribute “{name}”",
    "TANGENT": "UV map “{name}” (tangents)",
}
_UNNAMED = {"GEOMETRY": "attribute without name", "COLOR": "colour attribute", "TANGENT": "UV map (tangents)"}


# --- attributes of objects and view layers


def property_value(owner: Any, name: str) -> tuple[float, float, float, float] | None:
    """A property of a Blender object as RGBA: a custom one, else one of its own.

    None if the object has no such property that is made of 1 to 4 numbers.
    """
    if owner is None or not name:
        return None
    value = owner.get(name)
    if value is None:
        if name[-1] == "]" and not name.endswith('"]'):
            return None  # one element of a vector
        try:
            value = owner.path_resolve(name)
        except (ValueError, AttributeError, TypeError):
            return None
        if "." in name.rsplit("]", 1)[-1] and _is_part(owner, name):
            return None
    return _rgba(value)


def _is_part(owner: Any, name: str) -> bool:
    """Whether the path names a part of a vector, such as `location.x`, which is no property."""
    head = owner.path_resolve(name.rpartition(".")[0])
    return not hasattr(head, "bl_rna")


def _rgba(value: Any) -> tuple[float, float, float, float] | None:
    if isinstance(value, (bool, int, float)):
        return float(value), float(value), float(value), 1.0
    if isinstance(value, str) or not hasattr(value, "__len__") or not 1 <= len(value) <= 4:
        return None
    try:
        plain = [float(each) for each in value]
    except (TypeError, ValueError):
        return None
    red, green, blue, alpha = (*plain, *(0.0, 0.0, 0.0, 1.0)[len(plain) :])
    return red, green, blue, alpha


def object_value(
    obj: bpy.types.Object, parent: bpy.types.Object | None, kind: str, name: str
) -> tuple[float, float, float, float] | None:
    """An attribute of an object; for kind INSTANCER of the object that places it, if that has it."""
    owners = [parent] if kind == "INSTANCER" else []
    return next(
        (value for owner in (*owners, obj, obj.data) if (value := property_value(owner, name)) is not None), None
    )


def position_on_surface(placed: bpy.types.DepsgraphObjectInstance, name: str) -> tuple[float, ...]:
    """Position of an instance on the surface that places it: its generated coordinates as in Cycles, or its `uv`."""
    if name == "uv":
        return (*placed.uv, 0.0, 1.0)
    return (*(0.5 * x - 0.5 for x in placed.orco), 1.0)


def view_layer_value(
    scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, name: str
) -> tuple[float, float, float, float] | None:
    """An attribute of the view layer, its scene, or the scene's world."""
    owners = (view_layer, scene, scene.world)
    return next((value for owner in owners if (value := property_value(owner, name)) is not None), None)
