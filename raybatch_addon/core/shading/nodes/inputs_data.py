"""What input ops read of the scene beside its triangles: where objects are, their texture space, values at corners of triangles."""

import numpy as np
import warp as wp

from ...errors import SceneError
from ...scene.description import CameraKind, Instances, Scene
from ...scene.flatten import is_mirrored_where_baked
from ...scene.geometry import mat34
from .texture_space import generated_corners, texture_space_maps

# Ops that go between the spaces of world and object, and that know a mesh's texture space
_TEXTURE_SPACE_OPS = frozenset({"generated", "radial_tangent"})
_OBJECT_OPS = _TEXTURE_SPACE_OPS | {
    "object_coordinates", "object_normal", "object_location", "vector_transform", "normal_map", "uv_tangent", "displacement",
}  # fmt: skip
_ATTRIBUTE_OPS = frozenset({"attribute", "normal_map", "uv_tangent"})

PER_CORNER = 8  # of `InputData.attribute_layout`: there are values for each corner, not for each triangle
_NUMBERS_MOST = 2**31 - 1


@wp.struct
class InputData:
    """Arrays that no program of the scene reads have no entries."""

    to_object: wp.array(dtype=mat34)  # world to object, of each instance
    to_world: wp.array(dtype=mat34)  # object to world, also of what geometry has in world space already
    info: wp.array2d(dtype=float)  # of each instance; columns as `Instances.info`
    to_camera: mat34  # world to camera, which looks along +Z here
    camera_position: wp.vec3  # [m]
    perspective: int  # 0: orthographic
    pixel_width: float  # of a pixel one metre in front of the camera, or of an orthographic one's anywhere [m]
    window: wp.vec4  # `Camera.window`
    texture_offset: wp.array(dtype=wp.vec3)  # generated coordinates are position in object space times scale, plus offset; of each instance
    texture_scale: wp.array(dtype=wp.vec3)
    generated_first: wp.array(dtype=int)  # of each instance: first of its corners in the next, -1: the map above tells as well
    generated: wp.array(dtype=wp.vec3)  # generated coordinates of triangle corners
    uv_first: wp.array(dtype=int)  # of each instance: first of its corners in `uvs`, -1: it has none
    uvs: wp.array(dtype=wp.vec2)  # of triangle corners
    attribute_row: wp.array(dtype=int)  # of each instance: its row in the next two
    attribute_first: wp.array2d(dtype=int)  # first number of each of `Scene.attributes` in `attribute_values`, -1: it has none
    attribute_layout: wp.array2d(dtype=int)  # numbers of a value, and PER_CORNER
    attribute_values: wp.array(dtype=float)
    object_attributes: wp.array2d(dtype=wp.vec4)  # `Instances.attributes`


def upload_inputs(scene: Scene, ops: tuple[str, ...], device: wp.Device) -> InputData:
    """What programs with `ops` read of `scene`."""
    inputs = InputData()
    instances = scene.instances
    matrix = np.eye(4)
    matrix[:3] = scene.camera.transform
    to_camera = np.diag([1.0, 1.0, -1.0, 1.0]) @ np.linalg.inv(matrix)
    inputs.to_camera = mat34(*to_camera[:3].ravel().tolist())
    inputs.camera_position = wp.vec3(*matrix[:3, 3].tolist())
    inputs.perspective = int(scene.camera.kind == CameraKind.PERSPECTIVE)
    inputs.window = wp.vec4(*scene.camera.window)
    left, right, bottom, top = scene.camera.window
    inputs.pixel_width = 0.5 * ((right - left) / scene.frame.width + (top - bottom) / scene.frame.height)
    if not _OBJECT_OPS.isdisjoint(ops):
        inputs.to_object = wp.array(inverses(instances.transform), dtype=mat34, device=device)
        inputs.to_world = wp.array(np.asarray(instances.transform, np.float32), dtype=mat34, device=device)
    if "object_info" in ops and instances.info is not None:
        inputs.info = wp.array(np.asarray(instances.info, np.float32), dtype=float, device=device)
    if not _TEXTURE_SPACE_OPS.isdisjoint(ops):
        scale, offset = texture_space_maps(scene)
        inputs.texture_scale = wp.array(scale[instances.mesh].astype(np.float32), dtype=wp.vec3, device=device)
        inputs.texture_offset = wp.array(offset[instances.mesh].astype(np.float32), dtype=wp.vec3, device=device)
    if "generated" in ops:
        first, corners = _corner_values(scene, generated_corners(scene), 3)
        inputs.generated_first = wp.array(first, dtype=int, device=device)
        inputs.generated = wp.array(corners, dtype=wp.vec3, device=device)
    if "uv" in ops:
        first, uvs = _corner_values(scene, {i: mesh.corner_uvs for i, mesh in enumerate(scene.meshes) if mesh.corner_uvs is not None}, 2)
        inputs.uv_first = wp.array(first, dtype=int, device=device)
        inputs.uvs = wp.array(uvs, dtype=wp.vec2, device=device)
    if not _ATTRIBUTE_OPS.isdisjoint(ops):
        _upload_attributes(scene, inputs, device)
    if "object_attribute" in ops and instances.attributes is not None:
        inputs.object_attributes = wp.array(np.asarray(instances.attributes, np.float32), dtype=wp.vec4, device=device)
    return inputs


def upload_camera_inputs(scene: Scene, device: wp.Device) -> InputData:
    """The same where there are no instances, as in the world: of the camera alone."""
    return upload_inputs(Scene(scene.camera, scene.frame, instances=Instances.empty()), (), device)


def _upload_attributes(scene: Scene, inputs: InputData, device: wp.Device) -> None:
    """What meshes have of `Scene.attributes`, with the corners of triangles in the order that the geometry has them."""
    rows: dict[tuple[int, bool], int] = {}
    row_of = np.array([
        rows.setdefault(key, len(rows)) for key in zip(scene.instances.mesh.tolist(), is_mirrored_where_baked(scene).tolist())
    ], np.int32)  # fmt: skip
    first = np.full((max(len(rows), 1), max(len(scene.attributes), 1)), -1, np.int32)
    layout = np.zeros_like(first)
    places = {key: place for place, key in enumerate(scene.attributes)}
    chunks, count = [], 0
    for (mesh, mirrored), row in rows.items():
        for attribute in scene.meshes[mesh].attributes:
            place = places.get((attribute.kind, attribute.name))
            if place is None:
                continue
            values = np.asarray(attribute.values, np.float32)
            first[row, place] = count
            layout[row, place] = values.shape[-1] | (PER_CORNER if values.ndim == 3 else 0)
            chunks.append((values[:, [0, 2, 1]] if mirrored and values.ndim == 3 else values).ravel())
            count += len(chunks[-1])
    if count > _NUMBERS_MOST:
        raise SceneError(f"the attributes that materials read have {count:,} numbers; at most {_NUMBERS_MOST:,} can be indexed")
    inputs.attribute_row = wp.array(row_of, dtype=int, device=device)
    inputs.attribute_first = wp.array(first, dtype=int, device=device)
    inputs.attribute_layout = wp.array(layout, dtype=int, device=device)
    inputs.attribute_values = wp.array(np.concatenate(chunks) if chunks else np.zeros(0, np.float32), dtype=float, device=device)


def inverses(transform: np.ndarray) -> np.ndarray:
    """Inverses of transforms, float32, shape [n, 3, 4]; those of singular ones are 0."""
    matrix = np.asarray(transform, np.float64)
    result = np.zeros_like(matrix)
    usable = np.abs(np.linalg.det(matrix[:, :, :3])) > 0
    linear = np.linalg.inv(matrix[usable, :, :3])
    result[usable, :, :3] = linear
    result[usable, :, 3] = -np.einsum("nij,nj->ni", linear, matrix[usable, :, 3])
    return result.astype(np.float32)


def _corner_values(scene: Scene, of_meshes: dict[int, np.ndarray], width: int) -> tuple[np.ndarray, np.ndarray]:
    """Values [triangle_count, 3, width] of meshes by index, joined: first corner of each instance, int32, and float32 [n, width]."""
    first = np.full(len(scene.instances), -1, np.int32)
    chunks: list[np.ndarray] = []
    places: dict[tuple[int, bool], int] = {}
    count = 0
    mirrored = is_mirrored_where_baked(scene)
    for i, mesh_index in enumerate(scene.instances.mesh.tolist()):
        values = of_meshes.get(mesh_index)
        if values is None:
            continue
        key = (mesh_index, bool(mirrored[i]))
        if key not in places:
            # corners in the order that the geometry has them
            chunks.append((values[:, [0, 2, 1]] if key[1] else values).reshape(-1, width))
            places[key] = count
            count += len(chunks[-1])
        first[i] = places[key]
    return first, np.concatenate(chunks).astype(np.float32) if chunks else np.zeros((0, width), np.float32)
