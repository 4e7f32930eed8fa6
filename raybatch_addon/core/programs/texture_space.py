"""The space of generated texture coordinates: 0..1 across a box about a mesh.

Coordinates computed from a point in the world are only as exact as the point. That is enough except on faces along
which a coordinate is constant: a checker whose squares end in that very plane would be speckled by the rounding. For
such meshes the coordinates of corners are kept, so that they stay as even as the mesh is.
"""

import numpy as np

from ..scene.description import Scene
from ..scene.flatten import IDENTITY
from ..scene.frozen import fact
from ..scene.motion import deforming_meshes

_UNIT_BOX = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))


def texture_space_maps(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Scale and offset from object space to generated coordinates of each mesh, float64, shape [mesh_count, 3] each."""
    boxes = np.array([mesh.texture_space or _UNIT_BOX for mesh in scene.meshes], np.float64).reshape(-1, 2, 3)
    scale = 0.5 / np.where(boxes[:, 1] != 0, boxes[:, 1], 1.0)
    return scale, 0.5 - boxes[:, 0] * scale


def generated_corners(scene: Scene) -> dict[int, np.ndarray]:
    """Generated coordinates of the corners of meshes by index, float32, shape [triangle_count, 3, 3].

    Included are meshes with materials that read generated coordinates, if a coordinate is constant along a face and
    their transform is not the identity, or if they are displaced or deform: the coordinates are those of where vertices
    were.
    """
    instances = scene.instances
    asking = np.array([_asks(material) for material in scene.materials], bool)
    if not asking.any() or len(instances) == 0:
        return {}
    scale, offset = texture_space_maps(scene)
    deforms = deforming_meshes(scene)
    elsewhere = np.array([mesh.base_positions is not None for mesh in scene.meshes], bool) | deforms
    moved = np.flatnonzero(elsewhere[instances.mesh] | (np.asarray(instances.transform) != IDENTITY).any((1, 2)))
    by_mesh = moved[np.argsort(instances.mesh[moved], kind="stable")]
    meshes, starts = np.unique(instances.mesh[by_mesh], return_index=True)
    # number of materials before each slot that read generated coordinates
    before = np.concatenate([[0], np.cumsum(asking[scene.slot_materials])])
    result: dict[int, np.ndarray] = {}
    for index, placed in zip(meshes.tolist(), np.split(by_mesh, starts[1:])):
        mesh = scene.meshes[index]
        if len(mesh.triangles) == 0:
            continue
        slots = 1 if mesh.triangle_slot is None else int(mesh.triangle_slot.max()) + 1
        first = instances.slot_first[placed]
        if (before[first + slots] > before[first]).any() and (
            elsewhere[index] or fact(mesh.positions, _has_even_faces, mesh.triangles)
        ):
            before_moving = mesh.positions if mesh.base_positions is None else mesh.base_positions
            vertices = (before_moving * scale[index] + offset[index]).astype(np.float32)
            result[index] = vertices[mesh.triangles]
    return result


def _asks(material) -> bool:
    return material.program is not None and any(step.op == "generated" for step in material.program.instructions)


def _has_even_faces(positions: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether any triangle lies across an axis of object space."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    return bool(((a == b) & (a == c)).any())
