"""OBJ, PLY and glTF geometry through Blender's importers, with a default light and camera where the file has none."""

from __future__ import annotations

import math
from pathlib import Path

import bpy
import numpy as np
from lib.command import UsageError
from lib.geometry_files import (
    SKY_RADIANCE,
    SUN_ANGLE,
    SUN_IRRADIANCE,
    View,
    framing_view,
    parse_view,
    sun_axes,
    view_axes,
)
from lib.node_trees import with_nodes
from mathutils import Matrix

from raybatch_addon.core.errors import SceneError
from rendering.request import RESOLUTION_DEFAULT, Request

UP_DEFAULT = {".obj": "y", ".ply": "z", ".gltf": "y", ".glb": "y"}


def import_geometry(request: Request) -> None:
    """Put the geometry of the request's file into an empty scene; raises `SceneError`."""
    up = up_axis(request.source, request.up)
    view = parse_view(request.camera) if request.camera else None
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    import_objects(request.source, up)
    low, high = _bounds(scene)
    if low is None or high is None:
        raise SceneError(f"{request.source} has no faces to render; is it damaged?")

    scene.render.resolution_x, scene.render.resolution_y = request.resolution or RESOLUTION_DEFAULT
    scene.render.image_settings.file_format = "PNG"
    # the picture is geometry, not a graded photograph: the same colours as without Blender
    scene.view_settings.view_transform = "Standard"
    if view is not None and up == "y":
        view = View(_to_z_up(view.eye), _to_z_up(view.target), view.fov)
    cameras = [thing for thing in scene.objects if thing.type == "CAMERA"]
    if view is None and cameras:
        scene.camera = scene.camera or cameras[0]
        here = scene.camera.matrix_world
        eye = here.translation
        view = View(tuple(eye), tuple(eye - here.col[2].xyz), 1.0)
    else:
        view = view or framing_view(low, high, scene.render.resolution_x, scene.render.resolution_y, "z")
        _add_camera(scene, view, float(np.linalg.norm(high - low)))
    if not any(thing.type == "LIGHT" for thing in scene.objects):
        _add_light(scene, view)


def up_axis(source: Path, asked: str | None) -> str:
    """The axis that a file has up, `asked` for or as usual for its kind; raises `UsageError`."""
    suffix = source.suffix.lower()
    if suffix in (".gltf", ".glb") and asked == "z":
        raise UsageError("glTF has y up by definition; leave --up out")
    return asked or UP_DEFAULT.get(suffix, "z")


def import_objects(source: Path, up: str) -> None:
    """Put the objects of a file into the open scene, whose z is up, where `up` of the file is. Raises `SceneError`."""
    path, suffix = str(source.absolute()), source.suffix.lower()
    try:
        if suffix == ".obj":
            bpy.ops.wm.obj_import(filepath=path, **_axes(up))
        elif suffix == ".ply":
            bpy.ops.wm.ply_import(filepath=path, **_axes(up))
        else:
            bpy.ops.import_scene.gltf(filepath=path)
    except (RuntimeError, OSError, ValueError, KeyError) as error:
        text = " ".join(str(error).removeprefix("Error:").split())
        raise SceneError(f"{source} cannot be imported: {text or type(error).__name__}") from None


def _axes(up: str) -> dict[str, str]:
    """How an importer turns the file's axes into Blender's: z up, the front towards -y."""
    return {"up_axis": "Y", "forward_axis": "NEGATIVE_Z"} if up == "y" else {"up_axis": "Z", "forward_axis": "Y"}


def _to_z_up(point: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = point
    return x, -z, y


def _bounds(scene: bpy.types.Scene) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Corners of the box around everything that has faces."""
    bpy.context.view_layer.update()
    corners = []
    for thing in scene.objects:
        if thing.type == "MESH" and len(thing.data.polygons):
            matrix = np.array(thing.matrix_world)
            corners.append(np.array([corner[:] for corner in thing.bound_box]) @ matrix[:3, :3].T + matrix[:3, 3])
    if not corners:
        return None, None
    points = np.concatenate(corners)
    return points.min(0), points.max(0)


def _matrix(axes: np.ndarray, place) -> Matrix:
    return Matrix.LocRotScale(place, Matrix(axes.tolist()).to_quaternion(), None)


def _add_camera(scene: bpy.types.Scene, view: View, size: float) -> None:
    data = bpy.data.cameras.new("Camera")
    data.sensor_fit, data.angle = "AUTO", view.fov
    distance = math.dist(view.eye, view.target)
    data.clip_start, data.clip_end = max(1e-6, size * 1e-6), (distance + size) * 10  # all of it, near and far
    camera = bpy.data.objects.new("Camera", data)
    camera.matrix_world = _matrix(view_axes(view, "z"), view.eye)
    scene.collection.objects.link(camera)
    scene.camera = camera


def _add_light(scene: bpy.types.Scene, view: View) -> None:
    data = bpy.data.lights.new("Sun", "SUN")
    data.energy, data.angle = SUN_IRRADIANCE, SUN_ANGLE
    light = bpy.data.objects.new("Sun", data)
    light.matrix_world = _matrix(sun_axes(view, "z"), (0, 0, 0))
    scene.collection.objects.link(light)
    world = with_nodes(scene.world or bpy.data.worlds.new("World"))
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (*SKY_RADIANCE, 1.0)
    scene.world = world
