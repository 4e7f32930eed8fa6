"""What a scene must be before it is rendered: checked here, whoever made it."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..errors import SceneError
from .description import Camera, Frame, Instances, Mesh, Scene

# Squares of larger coordinates leave float32
COORDINATE_MAX = 1e18


def checked_scene(scene: Scene) -> Scene:
    """`scene` without what cannot be rendered, each named in its warnings.

    Raises `SceneError` when the camera or the frame cannot be used.
    """
    _check_camera(scene.camera)
    _check_frame(scene.frame)
    warnings: list[str] = []
    meshes = tuple(_checked_mesh(mesh, warnings) for mesh in scene.meshes)
    instances = _checked_instances(scene, warnings)
    if not warnings:
        return scene
    return dataclasses.replace(scene, meshes=meshes, instances=instances, warnings=(*scene.warnings, *warnings))


def _check_camera(camera: Camera) -> None:
    numbers = [*np.ravel(camera.transform), *camera.window, camera.clip_start, camera.lens_radius, camera.focus_distance]
    if not np.all(np.isfinite(numbers)) or np.isnan(camera.clip_end):
        raise SceneError("the camera's matrix or lens is not finite; reset its transform and check its constraints and drivers")
    if np.abs(camera.transform).max() > COORDINATE_MAX:
        raise SceneError(f"the camera is more than {COORDINATE_MAX:g} m away from the origin; reset its location and check its constraints and drivers")
    if abs(np.linalg.det(np.asarray(camera.transform, np.float64)[:, :3])) < 1e-3:
        raise SceneError("the camera's matrix is singular; set its scale (and its parents') to 1")
    left, right, bottom, top = camera.window
    if not (left != right and bottom != top):
        raise SceneError("the camera's window has no area; check its focal length or orthographic scale")


def _check_frame(frame: Frame) -> None:
    x0, y0, x1, y1 = frame.region
    if not (0 <= x0 < x1 <= frame.width and 0 <= y0 < y1 <= frame.height):
        raise SceneError(f"the rendered region {frame.region} is not inside the frame of {frame.width} x {frame.height} pixels")


def _checked_mesh(mesh: Mesh, warnings: list[str]) -> Mesh:
    """`mesh`, or one without triangles in its place."""
    reason = None
    if len(mesh.triangles):
        if mesh.triangles.min() < 0 or mesh.triangles.max() >= len(mesh.positions):
            reason = "has faces with vertices that do not exist"
        elif not np.isfinite(mesh.positions).all():
            reason = "has vertices that are not finite"
        elif np.abs(mesh.positions).max() > COORDINATE_MAX:
            reason = f"has coordinates beyond {COORDINATE_MAX:g} m"
    if reason is None:
        return mesh
    warnings.append(f"mesh “{mesh.name}” {reason}: it is not rendered")
    return Mesh(mesh.name, np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))


def _checked_instances(scene: Scene, warnings: list[str]) -> Instances:
    instances = scene.instances
    if len(instances) == 0:
        return instances
    linear = instances.transform[:, :, :3].astype(np.float64)
    finite = np.isfinite(instances.transform).all((1, 2)) & (np.abs(instances.transform).max((1, 2)) <= COORDINATE_MAX)
    linear[~finite] = 0
    # singular in float32: the smallest singular value is lost in the rounding of the largest
    singular_values = np.linalg.svd(linear, compute_uv=False)
    regular = singular_values[:, 2] > singular_values[:, 0] * np.finfo(np.float32).eps
    keep = finite & regular
    for i in np.flatnonzero(~keep):
        name = scene.object_names[instances.object[i]] if scene.object_names else f"instance {i}"
        why = "a matrix that is flat or zero" if finite[i] else "a matrix that is not finite"
        text = f"object “{name}” has {why}: it is not rendered"
        if text not in warnings:
            warnings.append(text)
    return Instances(*(getattr(instances, field.name)[keep] for field in dataclasses.fields(Instances)))
