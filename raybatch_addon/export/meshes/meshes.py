"""Blender's evaluated meshes as the core's `Mesh`es, read as whole arrays."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.scene.description import Mesh
from ...core.scene.notice import Notice, Weight
from .mesh_arrays import read, read_loops, read_positions, read_triangles, stored


def export_mesh(mesh: bpy.types.Mesh, name: str, warnings: list[str]) -> Mesh | None:
    """The triangles of `mesh`, evaluated; messages call it by the object `name`.

    Returns None for a mesh without triangles, and for one with vertices that are not finite. Vertices that no triangle
    uses are dropped. `warnings` gets a line for everything that was left out or repaired.
    """
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    if count == 0:
        if len(mesh.vertices):
            text = f"object “{name}”: its mesh “{mesh.name}” has no faces; there is nothing to render"
            warnings.append(Notice(text, Weight.REPAIRED, objects=[name]))
        return None
    loops = read_loops(mesh)
    corners = read_triangles(mesh, loops)
    positions, triangles = used_vertices(read_positions(mesh), corners)
    if not np.isfinite(positions).all():
        bad = int(len(positions) - np.isfinite(positions).all(axis=1).sum())
        warnings.append(
            Notice(
                f"object “{name}”: {bad:,} vertices of its mesh “{mesh.name}” are NaN or infinite; it is left out. "
                "Clean up the mesh, or check its modifiers and shape keys",
                Weight.REPAIRED,
                objects=[name],
            )
        )
        return None
    normals = uvs = None
    if mesh.normals_domain == "POINT" and not mesh.has_custom_normals:  # then corners have those of their vertices
        normals = read(mesh.vertex_normals, "vector", np.float32, len(mesh.vertices), 3)
        normals = _finite_normals(normals, mesh, name, warnings).take(corners, axis=0)
    elif mesh.normals_domain != "FACE" or mesh.has_custom_normals:
        normals = read(mesh.corner_normals, "vector", np.float32, len(mesh.loops), 3)
        normals = _finite_normals(normals, mesh, name, warnings).take(loops, axis=0)
    layer = next((layer for layer in mesh.uv_layers if layer.active_render), None)
    if layer is not None and len(layer.uv):
        uvs = read(layer.uv, "vector", np.float32, len(mesh.loops), 2).take(loops, axis=0)
    space = (tuple(mesh.texspace_location), tuple(mesh.texspace_size))
    flat = _flat(mesh, count) if normals is not None else None
    return Mesh(
        mesh.name,
        positions,
        triangles,
        _slots(mesh, count),
        corner_normals=normals,
        corner_uvs=uvs,
        texture_space=space,
        flat=flat,
    )


def mesh_velocity(mesh: bpy.types.Mesh, exported: Mesh, name: str, warnings: list[str]) -> np.ndarray | None:
    """The attribute “velocity” of the vertices of `exported` [m/s], shape [vertex_count, 3]; None: there is none, or
    `warnings` says what is wrong with that of the object `name`.
    """
    values = point_velocity(mesh, len(mesh.vertices), name, warnings)
    if values is None:
        return None
    mesh.calc_loop_triangles()
    triangles = read_triangles(mesh, read_loops(mesh))
    values, _ = used_vertices(values, triangles)
    return values if len(values) == len(exported.positions) else None


def point_velocity(owner: bpy.types.ID, count: int, name: str, warnings: list[str]) -> np.ndarray | None:
    """The attribute “velocity” of the `count` points of `owner`, float32, shape [count, 3]; None as in
    `mesh_velocity`.
    """
    attribute = owner.attributes.get("velocity")
    if attribute is None:
        return None
    values, fault = None, ""
    if attribute.domain != "POINT":
        fault = f"is of the domain {attribute.domain}, not of points"
    elif attribute.data_type != "FLOAT_VECTOR":
        fault = f"is of the type {attribute.data_type}, no vector"
    elif len(attribute.data) == count:
        values = read(attribute.data, "vector", np.float32, count, 3)
        bad = count - int(np.isfinite(values).all(axis=1).sum())
        fault = f"has {bad:,} values that are not finite" if bad else ""
    if fault:
        text = f"object “{name}”: the attribute “velocity” {fault}; nothing moves by it"
        warnings.append(Notice(text, Weight.REPAIRED, objects=[name]))
        return None
    return values


def slot_count(mesh: bpy.types.Mesh) -> int:
    """Number of material slots that `Mesh.triangle_slot` assumes; at least 1."""
    return max(1, len(mesh.materials))


def used_vertices(positions: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`positions` of the vertices that `triangles` use, and the triangles with indices into them."""
    used = np.zeros(len(positions), bool)
    used[triangles.ravel()] = True
    if used.all():
        return positions, triangles
    renumbered = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return positions[used], renumbered[triangles]


def _finite_normals(normals: np.ndarray, mesh: bpy.types.Mesh, name: str, warnings: list[str]) -> np.ndarray:
    """Unit `normals` of vertices or corners, shape [n, 3]; 0 (flat) where Blender has none."""
    # A sum is finite where all terms are: a cheap look before the close one
    if not np.isfinite(normals.sum()):
        finite = np.isfinite(normals).all(axis=1)
        warnings.append(
            Notice(
                f"object “{name}”: {int((~finite).sum()):,} normals of its mesh “{mesh.name}” are not finite; these "
                "corners are flat",
                Weight.REPAIRED,
                objects=[name],
            )
        )
        normals[~finite] = 0
    return normals


def _slots(mesh: bpy.types.Mesh, count: int) -> np.ndarray | None:
    """Material slot of each triangle, indices beyond the last slot lowered to it; None when all are slot 0."""
    last = slot_count(mesh) - 1
    if last == 0 or "material_index" not in mesh.attributes:
        return None
    of_polygon = stored(mesh, "material_index", "value", np.int32, len(mesh.polygons))
    if of_polygon is None:
        of_polygon = read(mesh.polygons, "material_index", np.int32, len(mesh.polygons))
    polygon = read(mesh.loop_triangle_polygons, "value", np.int32, count)
    slots = np.clip(of_polygon, 0, last)[polygon]
    return slots if slots.any() else None


def _flat(mesh: bpy.types.Mesh, count: int) -> np.ndarray | None:
    """Whether each triangle is of a face that is shaded flat; None where none is."""
    if "sharp_face" not in mesh.attributes:
        return None
    of_polygon = read(mesh.attributes["sharp_face"].data, "value", bool, len(mesh.polygons))
    if not of_polygon.any():
        return None
    return of_polygon[read(mesh.loop_triangle_polygons, "value", np.int32, count)]
