"""Meshes of earlier exports, found again by digests of what Blender stores of a mesh.

Blender evaluates a scene anew for every render, so that meshes have other addresses each time. Their numbers tell
whether they are the same. Attributes as Blender stores them are copied a hundred times as fast as triangles, normals
and what else it derives from them. The arrays of a kept mesh are frozen: what the core made of them may be kept too.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import bpy
import numpy as np
import warp as wp

from ...core.device.devices import free_memory
from ...core.scene.description import Attribute, Mesh
from ...core.scene.frozen import freeze
from .attributes import mesh_attributes
from .meshes import export_mesh

# A mesh that this many exports have not used is dropped
_EXPORTS_KEPT = 2
# Of the host's free memory, what kept meshes may take
_MEMORY_SHARE = 0.25

# Attributes that triangles, normals and materials follow from, wherever a mesh has them
_OF_SHAPE = frozenset(
    {
        "position",
        ".edge_verts",
        ".corner_vert",
        ".corner_edge",
        "sharp_face",
        "sharp_edge",
        "custom_normal",
        "material_index",
    }
)
# By Blender's type of an attribute: the property that `foreach_get` copies, and the type and count of its numbers
_STORED = {
    "FLOAT": ("value", np.float32, 1),
    "INT": ("value", np.int32, 1),
    "INT8": ("value", np.int8, 1),
    "BOOLEAN": ("value", bool, 1),
    "FLOAT2": ("vector", np.float32, 2),
    "FLOAT_VECTOR": ("vector", np.float32, 3),
    "FLOAT_COLOR": ("color", np.float32, 4),
    "BYTE_COLOR": ("color", np.float32, 4),
    "QUATERNION": ("value", np.float32, 4),
    "INT32_2D": ("value", np.int32, 2),
    "INT16_2D": ("value", np.int16, 2),
}


@dataclass
class _Kept:
    mesh: Mesh  # without attributes
    attributes: dict[tuple[bytes, str, str], Attribute]  # by digest of all attributes, kind and name
    used: int  # number of the export that last used it

    @property
    def bytes(self) -> int:
        """Memory that it takes on the host [bytes]."""
        return sum(
            array.nbytes for array in mesh_arrays(replace(self.mesh, attributes=tuple(self.attributes.values())))
        )


_kept: dict[bytes, _Kept] = {}  # by digest of the shape
_export_count = 0


def mesh_arrays(mesh: Mesh) -> list[np.ndarray]:
    """All arrays of `mesh`."""
    own = (mesh.positions, mesh.triangles, mesh.triangle_slot, mesh.corner_normals, mesh.corner_uvs)
    return [each for each in own if each is not None] + [each.values for each in mesh.attributes]


def forget_meshes() -> None:
    """Drop all meshes that are kept."""
    _kept.clear()


def end_export() -> None:
    """An export has ended: drop meshes that are not used any more, and the longest unused where they take too much."""
    global _export_count
    for digest in [digest for digest, each in _kept.items() if each.used <= _export_count - _EXPORTS_KEPT]:
        del _kept[digest]
    sizes = {digest: each.bytes for digest, each in _kept.items()}
    room = _MEMORY_SHARE * (free_memory(wp.get_device("cpu")) + sum(sizes.values()))
    for digest in sorted(sizes, key=lambda each: _kept[each].used):
        if sum(sizes.values()) <= room:
            break
        del _kept[digest], sizes[digest]
    _export_count += 1


class MeshSource:
    """A mesh of Blender's, evaluated, as often as the export asks for it or for more of its attributes."""

    def __init__(self, mesh: bpy.types.Mesh, user: str, warnings: list[str]) -> None:
        """Messages call the mesh by its object `user`; `warnings` gets them."""
        self._mesh, self._user, self._warnings = mesh, user, warnings
        mesh.calc_loop_triangles()
        self._shape = _digest(mesh, _is_of_shape(mesh))
        self._all: bytes | None = None

    def exported(self) -> Mesh | None:
        """The mesh without attributes; None if it has no triangles."""
        kept = _kept.get(self._shape)
        if kept is None:
            before = len(self._warnings)
            mesh = export_mesh(self._mesh, self._user, self._warnings)
            if mesh is None or len(self._warnings) > before:  # messages are those of this object
                return mesh
            for array in mesh_arrays(mesh):
                freeze(array)
            kept = _kept[self._shape] = _Kept(mesh, {}, _export_count)
        kept.used = _export_count
        return kept.mesh

    def attributes(self, asked: Iterable[tuple[str, str]]) -> list[Attribute]:
        """Attributes of kind and name `asked`, as far as the mesh has them."""
        asked, found = list(asked), []
        kept = _kept.get(self._shape)
        if asked and kept is not None and self._all is None:
            self._all = _digest(self._mesh, lambda attribute: True)
        for kind, name in asked:
            attribute = kept and kept.attributes.get((self._all, kind, name))
            if attribute:
                found.append(attribute)
                continue
            before = len(self._warnings)
            read = mesh_attributes(self._mesh, [(kind, name)], self._user, self._warnings)
            if kept is not None and len(self._warnings) == before:
                for each in read:
                    freeze(each.values)
                    kept.attributes[self._all, kind, name] = each
            found += read
        return found


def _is_of_shape(mesh: bpy.types.Mesh) -> Callable[[bpy.types.Attribute], bool]:
    layer = next((layer.name for layer in mesh.uv_layers if layer.active_render), None)
    return lambda attribute: attribute.name in _OF_SHAPE or attribute.name == layer


def _digest(mesh: bpy.types.Mesh, is_wanted: Callable[[bpy.types.Attribute], bool]) -> bytes:
    """Equal for equal meshes only, as far as the attributes go that `is_wanted`."""
    digest = hashlib.sha1(usedforsecurity=False)
    render_color = mesh.color_attributes.render_color_index
    names = (
        mesh.name,
        len(mesh.materials),
        tuple(mesh.texspace_location),
        tuple(mesh.texspace_size),
        mesh.normals_domain,
        mesh.has_custom_normals,
        next((layer.name for layer in mesh.uv_layers if layer.active_render), None),
        mesh.color_attributes[render_color].name if 0 <= render_color < len(mesh.color_attributes) else None,
    )
    digest.update(repr(names).encode())
    # how many corners each face has shows in its triangles
    _add(digest, mesh.loop_triangle_polygons, "value", np.int32, 1)
    stored = False
    for attribute in mesh.attributes:
        if not is_wanted(attribute):
            continue
        digest.update(repr((attribute.name, attribute.domain, attribute.data_type)).encode())
        if attribute.data_type in _STORED:
            _add(digest, attribute.data, *_STORED[attribute.data_type])
            stored |= attribute.name == "custom_normal"
    if mesh.has_custom_normals and not stored:  # Blender keeps them elsewhere
        _add(digest, mesh.corner_normals, "vector", np.float32, 3)
    return digest.digest()


def _add(digest, collection, attribute: str, dtype, width: int) -> None:
    values = np.empty(len(collection) * width, dtype)
    collection.foreach_get(attribute, values)
    digest.update(str(values.shape).encode())
    digest.update(values)
