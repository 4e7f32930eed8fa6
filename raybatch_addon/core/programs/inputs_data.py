"""Inputs that ops read of the scene besides its triangles: transforms of objects, texture spaces, values at corners."""

from collections.abc import Iterable

import numpy as np
import warp as wp

from ..device.bulk import kinds_of
from ..errors import SceneError
from ..scene.description import CameraKind, Instances, Mesh, Panorama, Scene
from ..scene.flatten import is_mirrored_where_baked
from ..scene.geometry import mat34
from ..shading.panorama import pixel_angle
from .texture_space import generated_corners, texture_space_maps

# Ops that convert between the spaces of world and object, and ops that use a mesh's texture space
_TEXTURE_SPACE_OPS = frozenset({"generated", "radial_tangent"})
_OBJECT_OPS = _TEXTURE_SPACE_OPS | {
    "volume_attribute",
    "volume_attribute_cubic",
    "object_coordinates",
    "object_normal",
    "object_location",
    "vector_transform",
    "normal_map",
    "uv_tangent",
    "displacement",
}
_ATTRIBUTE_OPS = frozenset({"attribute", "normal_map", "uv_tangent"})
# Ops that read anything of what `upload_inputs` uploads
INPUT_OPS = _OBJECT_OPS | _ATTRIBUTE_OPS | {"object_info", "uv", "object_attribute"}
# Ops that read where the camera is, or how wide its pixels are
CAMERA_OPS = frozenset({"bump", "camera_coordinates", "window_coordinates", "vector_transform", "wireframe"})

PER_CORNER = 8  # flag of `InputData.attribute_layout`: the values are those of corners, not of triangles
_NUMBERS_MOST = 2**31 - 1


@wp.struct
class InputData:
    """Inputs of ops on the device; an array that no program of the scene reads is empty."""

    to_object: wp.array(dtype=mat34)  # world to object, for each instance
    to_world: wp.array(dtype=mat34)  # object to world, also where the geometry is in world space already
    info: wp.array2d(dtype=float)  # row of each instance; columns as in `Instances.info`
    to_camera: mat34  # world to camera; the camera looks along +Z in these coordinates
    camera_position: wp.vec3  # [m]
    perspective: int  # 0: orthographic
    # width of a pixel one metre in front of a perspective camera, or at any distance from an orthographic one [m]
    pixel_width: float
    window: wp.vec4  # `Camera.window`
    # for each instance: generated coordinates are the position in object space times scale, plus offset
    texture_offset: wp.array(dtype=wp.vec3)
    texture_scale: wp.array(dtype=wp.vec3)
    # for each instance: its first corner in `generated`; -1: the map above is exact enough
    generated_first: wp.array(dtype=int)
    generated: wp.array(dtype=wp.vec3)  # generated coordinates of triangle corners
    uv_first: wp.array(dtype=int)  # for each instance: its first corner in `uvs`; -1: it has no UV map
    uvs: wp.array(dtype=wp.vec2)  # UV coordinates of triangle corners
    attribute_row: wp.array(dtype=int)  # for each instance: its row in the next two
    # first number of each of `Scene.attributes` in `attribute_values`; -1: the mesh lacks it
    attribute_first: wp.array2d(dtype=int)
    attribute_layout: wp.array2d(dtype=int)  # numbers of a value, and the flag PER_CORNER
    attribute_values: wp.array(dtype=float)
    object_attributes: wp.array2d(dtype=wp.vec4)  # `Instances.attributes`


def upload_inputs(scene: Scene, ops: tuple[str, ...], device: wp.Device) -> InputData:
    """The inputs that programs with `ops` read of `scene`."""
    inputs = InputData()
    instances = scene.instances
    _set_camera(inputs, scene)
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
        first, corners = corner_values(scene, generated_corners(scene), 3)
        inputs.generated_first = wp.array(first, dtype=int, device=device)
        inputs.generated = wp.array(corners, dtype=wp.vec3, device=device)
    if "uv" in ops:
        first, uvs = corner_values(
            scene, {i: mesh.corner_uvs for i, mesh in enumerate(scene.meshes) if mesh.corner_uvs is not None}, 2
        )
        inputs.uv_first = wp.array(first, dtype=int, device=device)
        inputs.uvs = wp.array(uvs, dtype=wp.vec2, device=device)
    if not _ATTRIBUTE_OPS.isdisjoint(ops):
        _upload_attributes(scene, inputs, device)
    if "object_attribute" in ops and instances.attributes is not None:
        inputs.object_attributes = wp.array(np.asarray(instances.attributes, np.float32), dtype=wp.vec4, device=device)
    return inputs


def corner_arrays(mesh: Mesh, ops: Iterable[str]) -> list[np.ndarray | None]:
    """The values at corners of `mesh` that programs with `ops` read. What they do not read may change: Blender's
    modifiers give UV maps whose last bits differ from evaluation to evaluation.
    """
    read = set(ops)
    arrays = [mesh.corner_uvs if "uv" in read else None]
    if not _ATTRIBUTE_OPS.isdisjoint(read):
        arrays += [each.values for each in mesh.attributes]
    return arrays


def with_camera(inputs: InputData, scene: Scene) -> InputData:
    """`inputs` with the camera and frame of `scene`: the arrays are the same."""
    seen = InputData()
    for name in InputData.vars:
        setattr(seen, name, getattr(inputs, name))
    _set_camera(seen, scene)
    return seen


def _set_camera(inputs: InputData, scene: Scene) -> None:
    matrix = np.eye(4)
    matrix[:3] = scene.camera.transform
    to_camera = _view_axes(scene.camera.kind) @ np.linalg.inv(matrix)
    inputs.to_camera = mat34(*to_camera[:3].ravel().tolist())
    inputs.camera_position = wp.vec3(*matrix[:3, 3].tolist())
    kind, frame = scene.camera.kind, scene.frame
    inputs.perspective = int(kind != CameraKind.ORTHOGRAPHIC)
    inputs.window = wp.vec4(*scene.camera.window)
    left, right, bottom, top = scene.camera.window
    inputs.pixel_width = 0.5 * ((right - left) / frame.width + (top - bottom) / frame.height)
    if kind.is_panorama:
        panorama = scene.camera.panorama or Panorama()
        inputs.pixel_width = pixel_angle(kind, panorama, scene.camera.window, frame.width, frame.height)


def _view_axes(kind: CameraKind) -> np.ndarray:
    """From a camera's own axes to those that programs see, as in Cycles: +Z is ahead, but panoramas look along +X with
    +Z up, and mirror balls along -Y.
    """
    if kind == CameraKind.MIRROR_BALL:
        return np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    if kind.is_panorama:
        return np.array([[0.0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    return np.diag([1.0, 1.0, -1.0, 1.0])


def bytes_of(inputs: InputData) -> int:
    """Memory that `inputs` take on their device [bytes]."""
    values = (getattr(inputs, name) for name in InputData.vars)
    return sum(int(each.capacity) for each in values if isinstance(each, wp.array))


def upload_camera_inputs(scene: Scene, device: wp.Device) -> InputData:
    """Inputs of programs without instances, as those of the world: only those of the camera."""
    return upload_inputs(Scene(scene.camera, scene.frame, instances=Instances.empty()), (), device)


def _upload_attributes(scene: Scene, inputs: InputData, device: wp.Device) -> None:
    """Fill in the meshes' values of `Scene.attributes`, with triangle corners in the order of the geometry."""
    rows, row_of = _kinds(scene)
    first = np.full((max(len(rows), 1), max(len(scene.attributes), 1)), -1, np.int32)
    layout = np.zeros_like(first)
    indices = {key: index for index, key in enumerate(scene.attributes)}
    chunks, count = [], 0
    for row, (mesh, mirrored) in enumerate(rows):
        for attribute in scene.meshes[mesh].attributes:
            index = indices.get((attribute.kind, attribute.name))
            if index is None:
                continue
            values = np.asarray(attribute.values, np.float32)
            first[row, index] = count
            layout[row, index] = values.shape[-1] | (PER_CORNER if values.ndim == 3 else 0)
            chunks.append((values[:, [0, 2, 1]] if mirrored and values.ndim == 3 else values).ravel())
            count += len(chunks[-1])
    if count > _NUMBERS_MOST:
        raise SceneError(
            f"the attributes that materials read have {count:,} numbers; at most {_NUMBERS_MOST:,} can be indexed"
        )
    inputs.attribute_row = wp.array(row_of, dtype=int, device=device)
    inputs.attribute_first = wp.array(first, dtype=int, device=device)
    inputs.attribute_layout = wp.array(layout, dtype=int, device=device)
    inputs.attribute_values = wp.array(
        np.concatenate(chunks) if chunks else np.zeros(0, np.float32), dtype=float, device=device
    )


def inverses(transform: np.ndarray) -> np.ndarray:
    """Inverses of transforms, float32, shape [n, 3, 4]; 0 for a singular transform. Each has the same bits whatever
    others there are.
    """
    matrix = np.asarray(transform, np.float64)
    result = np.zeros_like(matrix)
    usable = np.abs(np.linalg.det(matrix[:, :, :3])) > 0
    linear = np.linalg.inv(matrix[usable, :, :3])
    result[usable, :, :3] = linear
    x, y, z = (matrix[usable, None, axis, 3] for axis in range(3))
    result[usable, :, 3] = -(linear[:, :, 0] * x + linear[:, :, 1] * y + linear[:, :, 2] * z)
    return result.astype(np.float32)


def corner_values(scene: Scene, of_meshes: dict[int, np.ndarray], width: int) -> tuple[np.ndarray, np.ndarray]:
    """Values of meshes joined: first corner of each instance, int32, and values, float32, shape [n, width].

    `of_meshes` holds values by index of the mesh, each of shape [triangle_count, 3, width].
    """
    kinds, kind = _kinds(scene)
    chunks: list[np.ndarray] = []
    first, count = np.full(len(kinds), -1, np.int32), 0
    for i, (mesh, mirrored) in enumerate(kinds):
        values = of_meshes.get(mesh)
        if values is None:
            continue
        # corners in the order that the geometry has them
        chunks.append((values[:, [0, 2, 1]] if mirrored else values).reshape(-1, width))
        if count + len(chunks[-1]) > _NUMBERS_MOST:
            raise SceneError(
                f"the triangles whose UV maps or generated coordinates materials read have more than {_NUMBERS_MOST:,} "
                "corners, which is what can be indexed; use fewer triangles, or instances of one mesh"
            )
        first[i] = count
        count += len(chunks[-1])
    values = np.concatenate(chunks).astype(np.float32) if chunks else np.zeros((0, width), np.float32)
    return first[kind], values


def _kinds(scene: Scene) -> tuple[list[tuple[int, bool]], np.ndarray]:
    """The meshes that instances place, mirrored where they are baked or not, in the order in which they come first, and
    which of these each instance is, int32.
    """
    mesh, mirrored = scene.instances.mesh, is_mirrored_where_baked(scene)
    first, kind = kinds_of(2 * mesh + mirrored.astype(np.int32))
    return list(zip(mesh[first].tolist(), mirrored[first].tolist(), strict=True)), kind
