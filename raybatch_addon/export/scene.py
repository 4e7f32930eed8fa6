"""The evaluated depsgraph of Blender as the core's `Scene`."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np

from ..core.scene.description import Frame, Scene
from .camera import export_camera
from .drivers import failed_drivers
from .meshes.instances import Cancelled, collect_placements
from .passes import PASS_PROPERTIES, wanted_passes
from .world import export_world


def export_scene(depsgraph: bpy.types.Depsgraph, *, cancelled: Callable[[], bool] | None = None) -> Scene | None:
    """The view layer of the depsgraph's scene, as its active camera sees it.

    Returns None if `cancelled()`, which is called at least once for each mesh, returned True. Raises `SceneError` for a
    scene that cannot be rendered: without a camera, or with one that cannot be used.
    """
    scene = depsgraph.scene
    frame = export_frame(scene, depsgraph.view_layer)
    warnings: list[str] = []
    camera = export_camera(scene, depsgraph, frame.width, frame.height, warnings)
    try:
        placements = collect_placements(depsgraph, cancelled or (lambda: False))
    except Cancelled:
        return None
    collections = placements.materials.collections
    # evaluated: with the current values of drivers and keyframes
    world = export_world(_world(depsgraph.scene_eval, depsgraph.view_layer_eval), warnings, collections)
    instances = placements.instances()
    warnings += (
        placements.warnings
        + collections.warnings
        + failed_drivers(depsgraph)
        + _unsupported(scene, depsgraph.view_layer)
    )
    return Scene(
        camera=camera,
        frame=frame,
        meshes=tuple(placements.meshes),
        instances=instances,
        slot_materials=np.array(placements.slot_materials, np.int32),
        materials=tuple(placements.materials.materials),
        lights=tuple(placements.lights),
        world=world,
        images=tuple(collections.images),
        attributes=tuple(collections.attributes),
        object_names=tuple(placements.object_names),
        warnings=tuple(dict.fromkeys(warnings)),
    )


def export_frame(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> Frame:
    """The picture that the render settings ask for: size, border, alpha and passes."""
    render = scene.render
    width = render.resolution_x * render.resolution_percentage // 100
    height = render.resolution_y * render.resolution_percentage // 100
    width, height = max(1, width), max(1, height)
    border = None
    if render.use_border:
        # float32 and truncated, as Blender sizes its own buffer
        border = (
            int(np.float32(render.border_min_x) * np.float32(width)),
            int(np.float32(render.border_min_y) * np.float32(height)),
            int(np.float32(render.border_max_x) * np.float32(width)),
            int(np.float32(render.border_max_y) * np.float32(height)),
        )
        if border == (0, 0, width, height):
            border = None
    return Frame(width, height, border, bool(render.film_transparent), wanted_passes(view_layer))


def _world(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> bpy.types.World | None:
    """The world that lights the view layer, unless it is hidden."""
    return (getattr(view_layer, "world_override", None) or scene.world) if view_layer.use_sky else None


def _unsupported(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> list[str]:
    """Settings of the scene and the view layer that are not rendered, by name."""
    lines = []
    if scene.render.use_motion_blur and getattr(view_layer, "use_motion_blur", True):
        lines.append(f"scene “{scene.name}”: motion blur is not supported yet; the frame is rendered sharp")
    if scene.render.use_multiview:
        lines.append(f"scene “{scene.name}”: stereoscopy is not supported yet; every view shows the same picture")
    known = {"use_pass_combined", "use_pass_cryptomatte_accurate", *PASS_PROPERTIES}  # accuracy is no pass of its own
    asked = [
        p
        for p in view_layer.bl_rna.properties.keys()
        if p.startswith("use_pass_") and p not in known and getattr(view_layer, p) is True
    ]
    if asked:
        names = ", ".join(view_layer.bl_rna.properties[p].name for p in asked)
        lines.append(f"view layer “{view_layer.name}”: these passes are not supported yet and stay empty: {names}")
    return lines
